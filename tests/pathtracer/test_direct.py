"""Both engines, deterministic, at the same sample positions: 1e-4 of the mean, 1e-3 a pixel at the 99th percentile."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.pathtracer.direct import gather_light
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.samples import Ray
from mesoshell.pathtracer.shells import Shells
from mesoshell.render.camera import Camera, look_at, pixel_grid, pixel_radius, rays
from mesoshell.render.effects import plan_effects
from mesoshell.render.light import Distant
from mesoshell.scene.render_shell import facts
from mesoshell.shell.generator.texture_synthesis import TextureRequest, grow
from mesoshell.shell.geometry.extrude import Shell, extrude, patches_per_uv
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Scene
from tests.helpers import growing
from tests.helpers.path_traced import AGE, QUALITY, ROOT, box, rough, surface

SIZE = 32

LIGHT = np.array([0.3, 0.8, -0.5]) / np.linalg.norm([0.3, 0.8, -0.5])


def combed(shell: Shell) -> tuple[Bundle, tuple[int, int]]:
    """A texture whose geometry varies, and where it begins."""
    found, origin = grow(
        growing.bundle(), "it", shell.uv, TextureRequest(1, {}, {"length": lambda at: (at[..., 0] > 1) * 1.0})
    )
    return rough(found), origin


def grass(shell: Shell) -> tuple[Bundle, tuple[int, int]]:
    """Without its correction."""
    bundle = corrected(shell)[0]
    return replace(bundle, arrays={k: v for k, v in bundle.arrays.items() if k != "correction"}), (0, 0)


def corrected(shell: Shell) -> tuple[Bundle, tuple[int, int]]:
    return read_bundle(ROOT / "src/mesoshell/assets/grass.npz"), (0, 0)


BOX_VIEW = look_at((2.2, -1.5, 1.9), (0.5, 0.5, 0.4), (0.0, 0.0, 1.0))
SCENES = {
    "box": (box, 1.0, 1.0, BOX_VIEW),
    "combed": (box, 1.0, 0.4, BOX_VIEW),
    "spot": (lambda: load_mesh(ROOT / "tests/data/spot.obj"), 0.05, 0.1, look_at((1.5, 0.9, -2.4), (0, 0.05, 0.15))),
    "corrected": (
        lambda: load_mesh(ROOT / "tests/data/spot.obj"),
        0.05,
        0.1,
        look_at((1.5, 0.9, -2.4), (0, 0.05, 0.15)),
    ),
}


#: Of quality, what both engines honour, as few programs.
ALIKE = [
    {"coordinates": "exact", "visibility": "sample", "skip": 0.0},
    {"anisotropy": 4, "samples": 33, "height_filter": 1.0, "weight_cut": 0.0},
    {"filtering": False},
]
#: And each by itself.
ALONE = [
    {},
    {"coordinates": "exact"},
    {"anisotropy": 4},
    {"visibility": "sample"},
    {"samples": 33, "height_filter": 1.0, "skip": 0.0, "weight_cut": 0.0},
]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("box", {}),
        pytest.param("combed", {"skip": 0.0}, marks=pytest.mark.slow),
        *(("spot", changes) for changes in ALIKE),
        ("corrected", ALIKE[0]),
        *(pytest.param("spot", changes, marks=pytest.mark.slow) for changes in ALONE),
    ],
)
def test_the_engines_agree(name: str, changes: dict) -> None:
    make, thickness, scale, pose = SCENES[name]
    mesh = make()
    shell, camera = extrude(mesh, thickness, scale), Camera(pose, np.radians(40), SIZE, SIZE)
    bundle, origin = {"combed": combed, "corrected": corrected}.get(name, grass)(shell)
    quality = QUALITY.with_changes(**changes)
    light = Distant(LIGHT if name in ("spot", "corrected") else np.array([0.6, 0.0, 0.8]), np.full(3, 12.0))
    scene = Scene(
        mesh,
        shell,
        load_device_material(bundle, origin),
        camera,
        (light,),
        alpha=np.array([AGE], np.float32),
        patches_per_uv=patches_per_uv(mesh, shell),
        base_colour=(0.0, 0.0, 0.0),
    )
    effects = plan_effects(facts(scene), quality)
    expected, _ = render(scene, quality, effects)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    o, d = (mi.Vector3d(x.astype(np.float32).astype(np.float64).T.copy()) for x in (o, d))
    surfaces = surface(mesh)
    met = surfaces.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    n = SIZE * SIZE
    ray = Ray(
        o,
        d,
        dr.zeros(mi.Float64, n),
        dr.select(met.is_valid(), mi.Float64(met.t), dr.inf),
        dr.full(mi.Bool, True, n),
        dr.full(mi.Float, pixel_radius(camera.spread), n),
        dr.zeros(mi.Float, n),
    )
    shells = Shells([shell])
    lights = [(mi.Vector3f(*map(float, light.direction)), mi.Color3f(*map(float, light.irradiance)))]
    context = RenderContext(shells, Media(shells, [Medium(Material(bundle, origin), (AGE,))]), None, quality, effects)
    rgb, through, _ = gather_light(context, surfaces, ray, lights)
    rgb, mean = np.array(rgb).T.reshape(SIZE, SIZE, 3), expected[..., :3].mean()
    error = np.abs(rgb - expected[..., :3])
    assert mean > 1e-3
    loose = (
        1 if quality.filtering else 10
    )  # texels that no filter blurs are crossed within few of float32's steps of (u, v)
    assert error.mean() < 1e-4 * loose * mean
    # the bundled grass's correction is rough along h, where places differ in float32: of its mean over h this is 6e-4
    steep = 2 if name == "corrected" else 1
    assert np.quantile(error.max(axis=-1), 0.99) < 1e-3 * steep * loose * mean
    free = ~np.array(met.is_valid()).reshape(SIZE, SIZE)
    np.testing.assert_allclose(
        1 - np.array(through).reshape(SIZE, SIZE)[free], expected[..., 3][free], atol=2e-3 * loose
    )
