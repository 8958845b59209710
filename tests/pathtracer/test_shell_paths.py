"""The integrator in a scene of Mitsuba's: it ends, its pictures are finite, and a shell dims what lies behind it."""

import mitsuba as mi
import numpy as np
from test_shell_direct import AGE, QUALITY, ROOT, box

from mesoshell.io.bundle import read_bundle
from mesoshell.pathtracer import integrator
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium
from mesoshell.pathtracer.shells import Shells
from mesoshell.pathtracer.world import World
from mesoshell.shell.extrude import extrude

integrator.register()


def test_a_shell_under_a_white_sky_takes_light_away() -> None:
    """Rays that miss see the sky's 1; those that meet the shell see less, for nothing in it emits."""
    shells = Shells([extrude(box(), 1.0, 1.0)])
    media = Media(shells, [Medium(Material(read_bundle(ROOT / "src/mesoshell/assets/grass.npz")), (AGE,))])
    view = mi.ScalarTransform4f().look_at([2.2, -1.5, 1.9], [0.5, 0.5, 0.4], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "mesoshell_path", "max_depth": 3},
            "sensor": {"type": "perspective", "fov": 60, "to_world": view, "film": film},
            "sky": {"type": "constant"},
        }
    )
    scene.integrator().world = World(shells, media, QUALITY)
    rgb = np.array(mi.render(scene, spp=16))[..., :3]
    assert np.isfinite(rgb).all() and rgb.min() >= 0
    np.testing.assert_allclose(rgb[0], 1, atol=1e-5)
    assert rgb[10:14, 10:14].mean() < 0.7
