"""Where visibility of a light is tested: once an interval, or at every sample."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.bundle import Bundle
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.light import Distant
from mesoshell.render.quality import Quality
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Scene
from tests.helpers import scenes

DOWN = Distant(np.array([0.0, 0.0, 1.0]), np.full(3, 3.0))


def roof(edge: float) -> Mesh:
    """A square above the slab, over all that lies at y below `edge`."""
    corners = np.array([[-3, -3, 2], [4, -3, 2], [4, edge, 2], [-3, edge, 2]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][..., :2], "roof")


def seen(bundle: Bundle, quality: Quality, edge: float) -> float:
    """Radiance of the slab, thin as mist, along y in the plane where one interval reaches from side to side."""
    slab = scenes.slab(bundle)
    decoder = slab.device_material.material.decoder
    thin = slab.device_material.material._replace(decoder=decoder._replace(scale=jnp.asarray(1e-3, jnp.float32)))
    camera = Camera(look_at((0.3, -4.0, 0.5), (0.3, 0.5, 0.5), (0.0, 0.0, 1.0)), 1e-3, 1, 1)
    scene = Scene(
        slab.mesh,
        slab.shell,
        replace(slab.device_material, material=thin),
        camera,
        (DOWN,),
        alpha=slab.alpha,
        base_colour=(0.0, 0.0, 0.0),
        objects=(roof(edge),),
    )
    image, _ = render(scene, quality, scenes.effects(scene, quality))
    return float(image[0, 0, 1])


def test_a_shadows_edge_within_an_interval(tiny_bundle) -> None:
    """By samples, the light that is left is that of the samples beyond the edge; by intervals, whole intervals go dark."""
    by_sample = scenes.FULL.with_changes(visibility="sample", samples=128)
    parts = [seen(tiny_bundle, by_sample, y) for y in (-2.0, 0.25, 0.5, 0.75, 2.0)]
    open_sky, *lit = parts[:-1]
    assert open_sky > 0 and all(0.02 < x / open_sky < 0.98 for x in lit)
    assert np.all(np.diff(parts) < 0) and parts[-1] == 0
    by_interval = {seen(tiny_bundle, scenes.FULL.with_changes(samples=128), y) for y in np.linspace(0.05, 0.95, 10)}
    assert len(by_interval) <= 3
