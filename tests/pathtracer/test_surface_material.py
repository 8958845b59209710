"""Surface materials in scenes of Mitsuba's: what they answer, and where they are met, is as in the other engine; paths pass
them by chance, and carry the right amount of light.

Most materials here have one opacity and one ρ, so that what comes out is known.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, bounding_box, load_mesh
from mesoshell.io.surface import write_surface
from mesoshell.pathtracer import scene_dict
from mesoshell.pathtracer.load import load_dict, load_file
from mesoshell.pathtracer.samples import Ray, no_frame
from mesoshell.pathtracer.surface_material import SurfaceMaterial, SurfaceMeshes, density_around, draw_around
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.effects import Effect
from mesoshell.render.light import Distant
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.surface_material.intersector import Local, SurfaceIntersector
from mesoshell.surface_material.loader import load_device_material
from mesoshell.surface_material.renderer import SurfaceScene, _answered, plan, render
from mesoshell.surface_material.tables import surface_tables
from tests.helpers import wearing
from tests.helpers.path_traced import shell

ROOT = Path(__file__).parents[2]
QUALITY = PRESETS["normal"].with_changes(early_stop=0.0)
SIZE = 12
SPHERE = 4 * np.pi
AXIS = [1 / 3, 2 / 3, 2 / 3]
DOWN = {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": 3.0}
ASLANT = {"type": "directional", "direction": [-0.48, 0.6, -0.64], "irradiance": 3.0}
POINT = {"type": "point", "position": [-0.5, 0.2, 1.5], "intensity": 10.0}
SKY = {"type": "constant"}


def seen_from(
    *place: float, at: tuple = (0.5, 0.5, 0.0), up: tuple = (0, 1, 0), fov: float = 20.0, size: int = SIZE
) -> dict:
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgba"}
    view = mi.ScalarTransform4f().look_at(list(place), list(at), list(up))
    return {"type": "perspective", "fov": fov, "to_world": view, "film": film}


ABOVE = (0.5, 0.5, 2.0)


def surface_shape(folder: Path, mesh: str, name: str, given: dict | None = None, **more: Any) -> dict:
    bsdf = {
        "type": "mesoshell",
        "material": str(folder / f"{name}.npz"),
        **({"scale": 0.5} if given is None else given),
    }
    return {"type": "obj", "filename": str(folder / f"{mesh}.obj"), "bsdf": bsdf} | more


def scene(*shapes: dict, light: dict | None = None, depth: int = 2, eye: dict | None = None) -> dict:
    integrator = {"type": "path", "max_depth": depth}
    parts = {"type": "scene", "integrator": integrator, "sensor": eye or seen_from(*ABOVE), "light": light or DOWN}
    return parts | {f"shape{i}": shape for i, shape in enumerate(shapes)}


def diffuse(kind: str, albedo: float, where: Any = None, **more: Any) -> dict:
    surface = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}}
    return {"type": kind, "bsdf": surface} | ({} if where is None else {"to_world": where}) | more


def loaded(parts: dict, quality: Quality = QUALITY) -> Any:
    return load_dict(parts, quality)


def picture(parts: dict, spp: int = 64, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(loaded(parts), spp=spp, seed=mi.UInt32(seed)))


def means(made: Any, first: int, count: int = 12, spp: int = 64) -> np.ndarray:
    """(count, 4) mean colours of pictures, each with random numbers of its own."""
    runs = (np.array(mi.render(made, spp=spp, seed=mi.UInt32(k))) for k in range(first, first + count))
    return np.stack([run.mean(axis=(0, 1)) for run in runs])


def agree(a: np.ndarray, b: np.ndarray, sigmas: float = 4.5) -> None:
    """Two sets of estimates are of the same value, within what they vary by."""
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) <= sigmas * error + 1e-6).all(), (
        a.mean(axis=0),
        b.mean(axis=0),
        error,
    )


def segment(o: np.ndarray, d: np.ndarray, spread: float = 0.0, apex: float = 0.0) -> Ray:
    n = len(o)
    start, no = dr.zeros(mi.Float64, n), dr.full(mi.Bool, False, n)
    far, cone = dr.full(mi.Float64, dr.inf, n), (dr.full(mi.Float, spread, n), dr.full(mi.Float, apex, n))
    return Ray(mi.Vector3d(np.array(o.T)), mi.Vector3d(np.array(d.T)), start, far, no, *cone)


# --- answers


@pytest.mark.parametrize("opacity", ["direct", "cosine", "none"])
@pytest.mark.parametrize("curvature", [True, False])
def test_answers_are_the_other_engines_and_the_descriptions(opacity: str, curvature: bool) -> None:
    """Of two thousand queries of all kinds, to what float32 leaves; with a step and an offset of its own."""
    b = wearing.bundle(opacity=opacity, sees_curvature=curvature, hidden=(8, 6), step=0.05, offset=0.3)
    q = wearing.queries(2000)
    material = SurfaceMaterial(b)
    w, light, kappa = mi.Vector3f(q["w"].T), mi.Vector3f(q["light"].T), mi.Float(q["kappa"])
    alpha, features = material.eval_opacity(mi.Point2f(q["u"].T), mi.Float(q["r"]), w, kappa)
    rho = np.array(material.rho(features, w, light, kappa)).T
    alpha = np.array(alpha) + np.zeros(2000)
    wanted, _, wanted_rho = wearing.answers(b, **q)
    np.testing.assert_allclose(alpha, wanted, atol=2e-4)
    np.testing.assert_allclose(rho, wanted_rho, rtol=1e-3, atol=1e-4 * wanted_rho.max())
    u, r, toward, k = (q[name].astype(np.float64) for name in ("u", "r", "w", "kappa"))
    theirs, their_rho = _answered(
        load_device_material(b), Local(u, r, toward, k, np.zeros((2000, 3, 3))), q["light"][:, None]
    )
    np.testing.assert_allclose(alpha, theirs, atol=5e-5)
    np.testing.assert_allclose(rho, their_rho[:, 0], rtol=1e-4, atol=2e-5 * wanted_rho.max())
    assert rho.std() > 0.01 and (alpha.std() > 0.1 or opacity == "none")


@pytest.mark.parametrize("radius", [0.0, 1e-42, 1e30, np.inf, np.nan])
def test_any_footprint_has_an_answer(radius: float) -> None:
    """None, and one that is no number, are the finest level's; all that are wider than the period the coarsest's."""
    material = SurfaceMaterial(wearing.bundle())
    w = dr.normalize(mi.Vector3f(0.6, 0, 1e-3))

    def asked(r: float) -> np.ndarray:
        alpha, features = material.eval_opacity(mi.Point2f([0.3, -7.1], [0.9, 1e4]), mi.Float([r, r]), w, mi.Float(9.0))
        return np.stack([np.array(x) for x in (alpha, *features)])

    found = asked(radius)
    np.testing.assert_array_equal(found, asked(1e9 if radius > 1 else 1e-9))
    assert np.isfinite(found).all() and np.abs(asked(1e9) - asked(1e-9)).max() > 0.1


# --- places


class Recorder:
    """In the place of a material: its features are what it was asked."""

    levels: Any = [type("Level", (), {"width": 3})] * 3

    def eval_opacity(self, u, radius, w, kappa):
        return mi.Float(0.25) + 0 * kappa, [u.x, u.y, radius]


def toward(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    face = random.integers(len(mesh.faces), size=count)
    corner = mesh.vertices[mesh.faces[face]].astype(np.float64)
    place = np.einsum("ik,ikj->ij", random.dirichlet([2, 2, 2], count), corner)
    d = wearing.directions(random, count)
    return place - d, d


def mirrored(mesh: Mesh) -> Mesh:
    return replace(mesh, uv=mesh.uv * np.array([-1, 1], np.float32))


@pytest.mark.parametrize("name", ["spot", "mirrored", "lump"])
def test_meshes_are_met_as_by_the_other_engine(name: str) -> None:
    """Distance, side, place, footprint, κ, frame and ω of a thousand rays."""
    mesh = wearing.lump() if name == "lump" else load_mesh(ROOT / "tests/data/spot.obj")
    mesh = mirrored(mesh) if name == "mirrored" else mesh
    period = 0.2
    w, (o, d) = surface_tables(mesh, period, QUALITY), toward(mesh, 1000)
    theirs = SurfaceIntersector(w, np.zeros((0, 3, 3)))
    hits = theirs.meet(o, d)
    rows = np.flatnonzero(hits.face >= 0)
    assert len(rows) > 990
    spread, apex = 0.03, 0.4
    local = theirs.queries(hits, rows, d[rows], 0.5 * spread * (hits.t[rows] + apex))
    recorder: Any = Recorder()
    met = SurfaceMeshes([w], [recorder]).meet(segment(o, d, spread, apex), dr.full(mi.Bool, True, 1000))
    ours: dict[str, np.ndarray] = {
        "hit": np.array(met.hit)[rows],
        "t": np.array(met.t)[rows],
        "front": np.array(met.front)[rows],
        "u": np.stack([np.array(x) for x in met.features[:2]], axis=1)[rows],
        "radius": np.array(met.features[2])[rows],
        "kappa": np.array(met.kappa)[rows],
        "w": np.array(met.w).T[rows],
        "axes": np.stack([np.array(x).T for x in (met.frame.a, met.frame.b, met.frame.c)], axis=1)[rows],
        "normal": np.array(met.normal).T[rows],
    }
    same = np.abs(ours["t"] - hits.t[rows]) < 1e-4  # one that passes an edge on its other side meets another face
    assert ours["hit"].all() and same.mean() > 0.99
    np.testing.assert_array_equal(ours["front"][same], hits.front[rows][same])
    np.testing.assert_allclose(ours["normal"][same], theirs.normal[hits.face[rows]][same], atol=1e-5)
    np.testing.assert_allclose(np.abs((ours["u"] - local.u + 0.5) % 1 - 0.5)[same], 0, atol=3e-3)
    np.testing.assert_allclose(ours["radius"][same], local.radius[same], rtol=1e-3)
    assert (
        np.median(np.abs(ours["kappa"] - local.kappa)[same]) < 1e-5
        and np.abs(ours["kappa"] - local.kappa)[same].max() < 0.02
    )
    front = same & ours["front"]  # from within, where nothing is asked, they may differ
    np.testing.assert_allclose(ours["w"][front], local.w[front], atol=2e-3)
    np.testing.assert_allclose(ours["axes"][front], local.axes[front], atol=2e-3)
    handed = np.sign(np.linalg.det(ours["axes"]))
    assert (handed == -1).any() if name == "mirrored" else np.ptp(local.kappa) > 0.3


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-15])
def test_faces_without_area_in_the_chart_have_a_frame(size: float) -> None:
    lump = wearing.lump()
    uv = lump.uv.copy()
    uv[::3] = np.float32(size) * uv[::3]
    uv[1::3, :, 1] = 0.25
    mesh = replace(lump, uv=uv)
    o, d = toward(mesh, 500)
    recorder: Any = Recorder()
    met = SurfaceMeshes([surface_tables(mesh, 0.3, QUALITY)], [recorder]).meet(
        segment(o, d), dr.full(mi.Bool, True, 500)
    )
    axes = np.stack([np.array(x).T for x in (met.frame.a, met.frame.b, met.frame.c)], axis=1)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.tile(np.eye(3), (500, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(np.array(met.w), axis=0), 1, atol=1e-5)


def test_directions_are_drawn_with_their_density() -> None:
    """All around: its integral is 1, and of draws as many lie below each height as it says."""
    here, xi = no_frame(), np.random.default_rng(0).random((2, 100_000))
    turn = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, -1]])  # left-handed
    here.a, here.b, here.c = (mi.Vector3f(*map(float, row)) for row in turn)
    d, local, pdf = draw_around(here, mi.Point2f(xi))
    context, inner = np.array(d).T, np.array(local).T
    np.testing.assert_allclose(np.linalg.norm(context, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(context @ turn.T, inner, atol=1e-5)
    np.testing.assert_allclose(np.array(pdf), np.array(density_around(here, d)), rtol=1e-4)
    np.testing.assert_allclose((1 / np.array(pdf)).mean(), SPHERE, rtol=0.02)
    z = np.linspace(-1, 1, 20_001)
    across = mi.Vector3f(np.stack([np.sqrt(1 - z * z), 0 * z, -z]).astype(np.float32))
    p = np.array(density_around(here, across)) * 2 * np.pi
    below = np.concatenate([[0], np.cumsum((p[1:] + p[:-1]) / 2 * np.diff(z))])
    np.testing.assert_allclose(below[-1], 1, atol=1e-4)
    for height in (-0.9, -0.5, 0.0, 0.5, 0.9):
        np.testing.assert_allclose((inner[:, 2] < height).mean(), np.interp(height, z, below), atol=5e-3)
    assert p.min() > 0.01


# --- light


@pytest.mark.slow  # test_surface_cli compares the engines' pictures too
def test_the_engines_show_the_same(folder) -> None:
    """A random material on a body that shadows itself, whose α is between 0 and 1, by two lights: means within noise, and block
    by block."""
    mesh, b = load_mesh(folder / "lump.obj"), wearing.bundle()
    camera = Camera(look_at((2.2, -1.9, 1.3), (0.5, 0.5, 0.0), (0.0, 0.0, 1.0)), 0.6, 24, 24)
    toward = np.array([[0.48, -0.6, 0.64], [-0.6, -0.8, 0.0]])
    lights = tuple(Distant(x, np.array([3.0, 2.0, 1.0])) for x in toward)
    s = SurfaceScene(
        mesh, 1.0, camera, lights, None, (0.5, 0.5, 0.5), (), True, device_material=load_device_material(b)
    )
    theirs = render(s, Quality(pixel_samples=64, early_stop=0.0), plan(s, QUALITY))[0]
    assert ((theirs[..., 3] > 0.1) & (theirs[..., 3] < 0.9)).mean() > 0.15
    shape = surface_shape(folder, "lump", "rough", {"scale": 1.0})
    parts = scene(shape, light=scene_dict.distant(lights[0]), eye=scene_dict.sensor(camera, 64))
    made = loaded(parts | {"second": scene_dict.distant(lights[1])})
    runs = np.stack([np.array(mi.render(made, spp=128, seed=mi.UInt32(k))) for k in range(12)])
    mean, error = runs.mean(axis=(0, 1, 2)), runs.mean(axis=(1, 2)).std(axis=0, ddof=1) / np.sqrt(12)
    assert (error < 0.005 * mean).all()
    assert (np.abs(mean - theirs.mean(axis=(0, 1))) < 4.5 * error + 0.003 * mean).all(), (
        mean,
        theirs.mean(axis=(0, 1)),
    )
    blocks = [x.reshape(6, 4, 6, 4, 4).mean(axis=(1, 3)) for x in (runs.mean(axis=0), theirs)]
    assert np.abs(blocks[0] - blocks[1]).max() < 0.03 * blocks[1].max()


@pytest.mark.parametrize("depth", [2, 5])
def test_a_white_furnace(folder, depth: int) -> None:
    """A square of which all light comes back, under a sky of 1, cannot be seen, from above or along."""
    for place in (ABOVE, (0.5, -1.0, 0.1)):
        eye = seen_from(*place, up=(0, 0.1, 1), fov=40)
        found = picture(scene(surface_shape(folder, "square", "white"), light=SKY, depth=depth, eye=eye), spp=1024)
        np.testing.assert_allclose(found[..., :3].mean(), 1, atol=2e-3)
        np.testing.assert_allclose(found[..., :3], 1, atol=0.05)


def test_a_white_furnace_within_glass(folder) -> None:
    """Where no light can be asked for: directions are drawn, from below the horizon too."""
    glass = {"type": "sphere", "center": [0.5, 0.5, 0.0], "radius": 1.5, "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    eye = seen_from(0.5, -3.0, 3.0, fov=15)
    parts = scene(surface_shape(folder, "square", "white"), glass, light=SKY, depth=-1, eye=eye)
    parts["integrator"]["rr_depth"] = 64
    found = means(loaded(parts), 0, spp=128)[:, :3].mean(axis=1)
    error = found.std(ddof=1) / np.sqrt(len(found))
    assert error < 3e-3 and abs(found.mean() - 1) < 4 * error + 1e-4


def test_bodies_are_met_once_each(folder) -> None:
    """Half-opaque balls one behind the other: ½, and ¾; light comes to the one behind through the one before it."""
    eye = seen_from(0.0, 0.0, 12.0, at=(0, 0, 0), fov=0.5, size=4)
    found = means(loaded(scene(surface_shape(folder, "pair", "half"), eye=eye)), 0, spp=512)
    agree(found[:, 3:], np.full((2, 1), 0.75))
    agree(found[:, :1], np.full((2, 1), (0.5 + 0.25 * 0.5) * 0.2 * 3))
    beside = seen_from(0.6, 0.0, 12.0, at=(0.6, 0, 0), fov=0.5, size=4)
    found = means(loaded(scene(surface_shape(folder, "pair", "half"), eye=beside)), 0, spp=512)
    agree(found[:, 3:], np.full((2, 1), 0.5))
    agree(found[:, :1], np.full((2, 1), 0.5 * 0.2 * 3))


def grounds() -> tuple[dict, dict]:
    to = mi.ScalarTransform4f
    mirror = {"type": "twosided", "inner": {"type": "conductor", "material": "none"}}
    wall = {
        "type": "rectangle",
        "to_world": to().translate([0.5, 2.0, 0]).rotate([1, 0, 0], 90).scale(9),
        "bsdf": mirror,
    }
    return diffuse("rectangle", 0.5, to().translate([0, 0, -1]).scale(9)), wall


@pytest.mark.parametrize("light", [ASLANT, SKY, POINT])
def test_what_is_not_there_changes_nothing(folder, light: dict) -> None:
    """α = 0 before objects, in their light, and in a mirror: the scene is what it is without."""
    eye = seen_from(0.5, -4.0, 1.5, up=(0, 0, 1), fov=40)
    with_it = loaded(scene(surface_shape(folder, "lump", "none"), *grounds(), light=light, depth=4, eye=eye))
    without = mi.load_dict(scene(*grounds(), light=light, depth=4, eye=eye))
    assert with_it.integrator().context is not None
    one, two = means(with_it, 0), means(without, 50)
    assert one[:, :3].mean() > 0.02
    agree(one, two)


def test_half_a_material_casts_half_a_shadow(folder) -> None:
    """On an object, seen past the body: half the light is left in its shadow, and all of it elsewhere; of a lamp under
    a ceiling too, which does not stand in its way."""
    to = mi.ScalarTransform4f()
    ground, ceiling = (diffuse("rectangle", 0.5, to.translate([0, 0, z]).scale(9)) for z in (-2, 3.5))
    lamp = {"type": "point", "position": [0.0, 0.0, 3.0], "intensity": 60.0}
    for place, share in ((0.3, 0.5), (2.5, 1.0)):
        eye = seen_from(place, 4.0, -1.0, at=(place, 0, -2), up=(0, 0, 1), fov=0.5, size=4)
        ball, far = surface_shape(folder, "ball", "half"), place**2 + 25
        for parts, irradiance in (
            (scene(ball, ground, eye=eye), 3.0),
            (scene(ball, ground, ceiling, light=lamp, eye=eye), 60 * 5 / far**1.5),
        ):
            found = means(loaded(parts), 0, 4, spp=32)
            np.testing.assert_allclose(found[:, 0], share * irradiance * 0.5 / np.pi, rtol=2e-3)
            np.testing.assert_allclose(found[:, 3], 1)


def test_a_lamp_that_is_passed_stands_in_no_light(folder) -> None:
    """Between a body and a sun."""
    body = surface_shape(folder, "square", "opaque")
    lamp = diffuse("rectangle", 0.0, mi.ScalarTransform4f().translate([0.5, 0.5, 1.0]).rotate([1, 0, 0], 180))
    lamp["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 1e-6}}
    path = {"integrator": {"type": "mesoshell_path", "max_depth": 2, "hide_lamps": True}}
    alone, lit = (picture(scene(*shapes) | path, spp=256)[..., 0].mean() for shapes in ((body,), (body, lamp)))
    assert alone > 0.3
    np.testing.assert_allclose(lit, alone, rtol=0.02)


def test_shadows_reach_beyond_all_other_objects(folder) -> None:
    """A square that faces down hides the light of the one below it, in a scene with nothing else, and with a small thing."""
    small = diffuse("sphere", 0.5, center=[0.05, 0.05, 0.02], radius=0.01)
    eye = seen_from(0.3, -1.0, 0.3, at=(0.05, 0.05, 0), up=(0, 0, 1), fov=1)
    for others in ((), (small,)):
        shapes = [(surface_shape(folder, name, "opaque"), *others) for name in ("square", "roofed")]
        lit, dark = (picture(scene(*x, eye=eye)) for x in shapes)
        np.testing.assert_allclose(lit[-4:, :, 0], 0.2 * 3.0, rtol=1e-5)
        assert (dark[..., 3] == 1).all() and dark[..., 0].max() == 0
    # of a sky, the solid angle of a rectangle is hidden, by the four about the foot of its perpendicular
    lit, dark = (
        means(loaded(scene(surface_shape(folder, name, "opaque"), light=SKY, eye=eye)), 0)
        for name in ("square", "roofed")
    )
    near, far = 0.05, 0.95
    hidden = sum(np.arctan(a * b / np.sqrt(a * a + b * b + 1)) for a in (near, far) for b in (near, far))
    agree(lit[:, :1], np.full((2, 1), 0.2 * SPHERE))
    agree(dark[:, :1], np.full((2, 1), 0.2 * (SPHERE - hidden)))


@pytest.mark.parametrize("light", [DOWN, ASLANT])
def test_no_light_is_lost_on_a_convex_body(folder, light: dict) -> None:
    """Of few faces, whose normals are interpolated: α ρ E in every pixel, also where the light is at the horizon."""
    eye = seen_from(1.9, -2.0, 1.0, at=(0, 0, 0), up=(0, 0, 1), fov=25, size=24)
    found = picture(scene(surface_shape(folder, "few", "opaque"), light=light, eye=eye))
    assert 0.1 < found[..., 3].mean() < 0.9
    np.testing.assert_allclose(found[..., 0], found[..., 3] * 0.2 * 3.0, rtol=1e-4)


def test_light_from_below_comes_through_a_sheet(folder) -> None:
    up = DOWN | {"direction": [0.0, -0.6, 0.8]}
    found = picture(scene(surface_shape(folder, "square", "opaque"), light=up))
    np.testing.assert_allclose(found[..., 0], 0.2 * 3.0, rtol=1e-5)
    below = diffuse("rectangle", 0.5, mi.ScalarTransform4f().translate([0, 0, -1]).scale(9))
    assert picture(scene(surface_shape(folder, "square", "opaque"), below, light=up))[..., :3].max() == 0


@pytest.mark.parametrize("away", [1e3, 1e5])
def test_a_scene_far_off_is_the_same(folder, away: float) -> None:
    """Half a material is half there, and its light half of it, though coordinates are rounded."""
    to = mi.ScalarTransform4f()
    place = to.translate([away, 0.7 * away, away]).rotate(AXIS, 40)
    normal, middle = np.array(place.matrix, float)[:3, 2], (np.array(place.matrix, float) @ [0.5, 0.5, 0, 1])[:3]
    eye = seen_from(*(middle + 3 * normal + [0.2, 0.1, 0]).tolist(), at=tuple(middle.tolist()), fov=8)
    light = DOWN | {"direction": (-normal).tolist()}
    found = means(
        loaded(scene(surface_shape(folder, "square", "half", to_world=place), light=light, eye=eye)), 0, spp=128
    )
    agree(found[:, 3:], np.full((2, 1), 0.5))
    agree(found[:, :1], np.full((2, 1), 0.5 * 0.2 * 3))


@pytest.mark.parametrize(
    "light, depth, off",
    [
        (SKY, 4, {"roulette"}),
        (POINT, 2, {"roulette", "environment", "background", "bounces"}),
        (POINT, 4, {"roulette", "environment", "background"}),
    ],
)
def test_effects_that_are_off_change_nothing(folder, light: dict, depth: int, off: set) -> None:
    """What the plan leaves out is not needed: with all of it compiled, the same picture within its noise."""
    eye = seen_from(2.2, -1.9, 1.3, up=(0, 0, 1), fov=35)
    made = loaded(scene(surface_shape(folder, "lump", "rough"), grounds()[0], light=light, depth=depth, eye=eye))
    context = made.integrator().context
    left_out = {name for name, effect in vars(context.effects).items() if not effect.on}
    others = {"area_light", "shells", "shell_shadow", "camera_in_shell", "quadrature", "varying_parameters"}
    others |= {"varying_geometry", "baked_density", "filtering", "anisotropic_filtering", "twin", "corner_tiles"}
    assert left_out == off | others
    gated = means(made, 0, 16)
    assert gated[:, :3].mean() > 0.01
    every = {name: Effect(name not in ("quadrature", "shells"), "for the test") for name in vars(context.effects)}
    context.effects = replace(context.effects, **every)
    agree(gated, means(made, 16, 16))


def test_a_furnace_of_many_bounces(folder) -> None:
    """Under a sky of 1 all is 1, however opaque it is here and there, if all light comes back from what is met: a body that
    shadows itself, squares that face each other, and a white ball between."""
    patchy, white = wearing.bundle(), wearing.constant(1.0, 1 / SPHERE)
    arrays = {k: (white if k.startswith("reflectance") else patchy).arrays[k] for k in patchy.arrays}
    write_surface(folder / "patchy.npz", replace(patchy, arrays=arrays))
    to = mi.ScalarTransform4f()
    squares = surface_shape(folder, "roofed", "patchy", to_world=to.translate([2, 0, -0.5]))
    ball = diffuse("sphere", 1.0, center=[1.7, 0.2, 0.3], radius=0.3)
    eye = seen_from(1.5, -4.0, 1.0, at=(1.5, 0.5, 0.0), up=(0, 0, 1), fov=35)
    for depth, rr_depth in ((-1, 8), (-1, 1000)):
        parts = scene(surface_shape(folder, "lump", "patchy"), squares, ball, light=SKY, depth=depth, eye=eye)
        parts["integrator"]["rr_depth"] = rr_depth
        found = means(loaded(parts), 0, spp=64)
        assert (found[:, :3].std(axis=0, ddof=1) < 0.02).all()
        agree(found[:, :3], np.ones((2, 3)))


def test_two_materials_in_one_scene(folder) -> None:
    """Of other sizes, and twice one of them: each is what it is alone."""
    to = mi.ScalarTransform4f()
    left, right, third = (to.translate([x, 0, 0]) for x in (0.0, 2.0, 4.0))
    asked = [("rough", left, 0.5), ("other", right, 0.7), ("rough", third, 0.25)]
    eyes = [seen_from(x + 0.5, 0.2, 2.0, at=(x + 0.5, 0.5, 0), fov=15) for x in (0.0, 2.0, 4.0)]
    shapes = [surface_shape(folder, "square", name, {"scale": scale}, to_world=where) for name, where, scale in asked]
    together = loaded(scene(*shapes, light=ASLANT))
    assert len(together.integrator().context.surface_meshes.materials) == 2
    for shape, eye in zip(shapes, eyes, strict=True):
        alone = loaded(scene(shape, light=ASLANT))
        one, two = (np.array(mi.render(s, spp=512, sensor=mi.load_dict(eye))) for s in (together, alone))
        assert two[..., 0].mean() > 0.01 and two[..., :3].std() > 0.005
        np.testing.assert_allclose(one, two, atol=1e-4)


def test_a_material_in_the_middle_of_a_shell(folder) -> None:
    """It is seen, and lit, through half of a black fog: e^(−σh) of what it is; of one that is not there, nothing is seen in a
    mist."""

    def in_it(name: str, what: str) -> dict:
        half = mi.ScalarTransform4f().translate([0, 0, 0.5])
        return scene(
            shell(folder, name) | {"filename": str(folder / "square.obj")},
            surface_shape(folder, "square", what, to_world=half),
            eye=eye,
        )

    eye = seen_from(*ABOVE, fov=5, size=4)
    exact = QUALITY.with_changes(skip=0.0, samples=32)
    made: Any = load_dict(in_it("fog", "opaque"), exact)
    assert made.integrator().context.effects.shells.on and made.integrator().context.effects.surface_materials.on
    found = means(made, 0)
    agree(found[:, :1], np.full((2, 1), 0.2 * 3.0 * np.exp(-1.0)))
    agree(found[:, 3:], np.ones((2, 1)))
    found = means(load_dict(in_it("fog", "half"), exact), 0)
    agree(found[:, :1], np.full((2, 1), 0.5 * 0.2 * 3.0 * np.exp(-1.0)))
    bare = scene(shell(folder, "mist") | {"filename": str(folder / "square.obj")}, eye=eye)
    agree(means(load_dict(in_it("mist", "none"), exact), 0), means(load_dict(bare, exact), 30))


# --- scenes


def placed(folder: Path, matrix: np.ndarray, *others: dict) -> tuple[dict, ...]:
    group = {"type": "shapegroup", "lump": surface_shape(folder, "lump", "solid", {"scale": 2.0})}
    group |= {f"other{i}": shape for i, shape in enumerate(others)}
    instance = {"type": "instance", "group": {"type": "ref", "id": "shape0"}, "to_world": mi.ScalarTransform4f(matrix)}
    return group, instance


@pytest.mark.parametrize("mirror", [False, True])
def test_an_instance_is_the_mesh_moved(folder, mirror: bool) -> None:
    """Turned, moved, twice as large and mirrored: seen with a camera and a light that were moved along, the same picture."""
    eye, size = seen_from(2.2, -1.9, 1.3, up=(0, 0, 1), fov=35), 2.0
    plain = picture(scene(surface_shape(folder, "lump", "solid", {"scale": 2.0}), light=ASLANT, eye=eye), spp=512)
    matrix = np.array(mi.ScalarTransform4f().translate([3, -2, 1]).rotate(AXIS, 70).scale(size).matrix, float)
    matrix = matrix @ np.diag([-1.0, 1, 1, 1]) if mirror else matrix
    turn, pose = matrix[:3, :3] / size, np.array(eye["to_world"].matrix, float)
    pose[:3, 3] = (matrix @ pose[:, 3])[:3]
    pose[:3, :3] = turn @ pose[:3, :3] @ np.diag([-1.0 if mirror else 1.0, 1, 1])
    light = ASLANT | {"direction": (turn @ ASLANT["direction"]).tolist()}
    there = eye | {"to_world": mi.ScalarTransform4f(pose)}
    found = picture(scene(*placed(folder, matrix), light=light, eye=there), spp=512)
    found = found[:, ::-1] if mirror else found
    assert plain[..., 0].mean() > 0.02 and 0.1 < plain[..., 3].mean() < 0.9
    assert np.abs(found - plain).mean() < 0.03 * plain.mean()
    other = picture(scene(surface_shape(folder, "lump", "solid", {"scale": 1.0}), light=ASLANT, eye=eye), spp=64)
    assert np.abs(other - plain).mean() > 0.1 * plain.mean()


def test_what_else_is_in_a_group_stays(folder) -> None:
    """And instances are as many as there are."""
    ball = diffuse("sphere", 0.5, center=[0.5, 0.5, 1.0], radius=0.3)
    far = np.array(mi.ScalarTransform4f().translate([5, 0, 0]).matrix, float)
    group, instance = placed(folder, far, ball)
    second = instance | {"to_world": mi.ScalarTransform4f().translate([9, 0, 0])}
    made = loaded(scene(group, instance, second, light=DOWN))
    context = made.integrator().context
    assert len(context.surface_meshes.which) == 2 * len(wearing.lump().faces)
    assert len([s for s in made.shapes() if not s.is_mesh()]) >= 2
    for x in (5.5, 9.5):
        eye = mi.load_dict(seen_from(x, 0.5, 4.0, at=(x, 0.5, 0), fov=2))
        np.testing.assert_allclose(np.array(mi.render(made, spp=16, sensor=eye))[..., 3], 1)


def test_a_mirror_shows_the_material(folder) -> None:
    """A camera that looks at a mirror sees what its own mirror image sees without it."""
    eye = seen_from(2.2, -1.9, 1.3, up=(0, 0, 1), fov=35)
    pose = np.diag([1.0, -1, 1, 1]) @ np.array(eye["to_world"].matrix, float) @ np.diag([-1.0, 1, 1, 1])
    pose[1, 3] += 2 * -1.0
    to = mi.ScalarTransform4f()
    wall = {"type": "rectangle", "to_world": to.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20)}
    wall["bsdf"] = {"type": "twosided", "inner": {"type": "conductor", "material": "none"}}
    through = eye | {"to_world": mi.ScalarTransform4f(pose)}
    behind = ASLANT | {"direction": [-0.48, -0.6, -0.64]}
    front = picture(scene(surface_shape(folder, "lump", "rough"), light=behind, eye=eye), spp=512)[..., :3]
    seen = picture(scene(surface_shape(folder, "lump", "rough"), wall, light=behind, depth=3, eye=through), spp=2048)[
        ..., :3
    ][:, ::-1]
    assert front.mean() > 0.01
    assert np.abs(seen - front).mean() < 0.06 * front.mean()


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"thickness": 0.1}, "thickness is for shells: a surface material takes only a scale"),
        ({"seed": 3}, "seed is for shells"),
        ({"age": 0.5}, "age is for shells"),
        ({"age": {"type": "bitmap", "bitmap": "", "raw": True}}, "age is for shells"),
        ({"scale": 0.0}, "scale must be above 0, not 0"),
        ({"scale": -2.0}, "scale must be above 0, not -2"),
        ({"scale": float("inf")}, "scale must be above 0, not inf"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(folder, asked: dict, said: str) -> None:
    """With its place and the material."""
    if isinstance(asked.get("age"), dict):
        asked = {"age": asked["age"] | {"bitmap": mi.Bitmap(np.ones((2, 2, 1), np.float32))}}
    with pytest.raises(InputError, match=said) as fault:
        loaded(scene(surface_shape(folder, "square", "rough", asked)))
    text = str(fault.value)
    assert "\n" not in text and "shape0.bsdf" in text and "rough.npz" in text


def test_a_material_that_is_not_there_is_said_with_its_place(folder) -> None:
    (folder / "bad.npz").write_bytes(b"hello")
    for name, said in (("nothing", "no such material"), ("bad", "not a zip file")):
        with pytest.raises(InputError, match=said) as fault:
            loaded(scene(surface_shape(folder, "square", name)))
        assert "\n" not in str(fault.value) and "shape0.bsdf" in str(fault.value)


def test_files_of_mitsubas_are_read(folder, tmp_path) -> None:
    """A material beside the scene; a parameter of shells is refused with its line."""

    def written(more: str) -> Path:
        path = folder / "scene.xml"
        path.write_text(f"""<scene version="3.0.0">
            <integrator type="path"><integer name="max_depth" value="$depth"/></integrator>
            <sensor type="perspective"><float name="fov" value="10"/>
                <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film>
                <transform name="to_world"><lookat origin="0.5, 0.5, 2" target="0.5, 0.5, 0" up="0, 1, 0"/></transform>
            </sensor>
            <emitter type="directional"><vector name="direction" x="0" y="0" z="-1"/>
                <rgb name="irradiance" value="3"/></emitter>
            <shape type="obj"><string name="filename" value="square.obj"/>
                <bsdf type="mesoshell"><string name="material" value="opaque.npz"/>{more}</bsdf></shape></scene>""")
        return path

    made: Any = load_file(written('<float name="scale" value="0.25"/>'), depth=3)
    assert made.integrator().max_depth == 3
    np.testing.assert_allclose(np.array(mi.render(made, spp=4))[..., :3], 0.2 * 3.0, rtol=1e-5)
    with pytest.raises(InputError, match=r"scene\.xml.*thickness is for shells") as fault:
        load_file(written('<float name="thickness" value="1"/>'), depth=3)
    assert "\n" not in str(fault.value)


def test_what_was_not_trained_is_said(folder) -> None:
    write_surface(folder / "narrow.npz", wearing.constant(1.0, 0.2, curvature=(-0.1, 0.1)))
    made = loaded(scene(surface_shape(folder, "ball", "narrow")))
    assert any("shape0.bsdf" in n and "outside the trained -0.1 to 0.1" in n for n in made.integrator().context.notes)
    assert not any(
        "trained" in n for n in loaded(scene(surface_shape(folder, "ball", "opaque"))).integrator().context.notes
    )


def test_the_scale_is_a_25th_of_two_diagonals_if_none_is_given(folder) -> None:
    context = loaded(scene(surface_shape(folder, "lump", "rough", {}))).integrator().context
    box = bounding_box(load_mesh(folder / "lump.obj"))
    np.testing.assert_allclose(
        np.array(context.surface_meshes.period), 2 / 25 * np.linalg.norm(box[1] - box[0]), rtol=1e-5
    )


def test_a_scene_without_ours_is_mitsubas_own(folder) -> None:
    parts = scene(diffuse("sphere", 0.5, center=[0.5, 0.5, 0], radius=0.3), light=SKY)
    made = loaded(parts)
    assert type(made.integrator()).__module__.startswith("mitsuba")
    one, two = (np.array(mi.render(s, spp=4)) for s in (made, mi.load_dict(parts)))
    np.testing.assert_array_equal(one, two)


def test_surface_materials_are_all_that_is_there(folder) -> None:
    """What shows which effects there are: with a material alone no shells, with neither Mitsuba's integrator."""
    effects = loaded(scene(surface_shape(folder, "square", "half"))).integrator().context.effects.as_dict()
    assert effects["surface_materials"] == {"on": True, "why": "on 1 of the meshes"}
    assert not effects["shells"]["on"] and not effects["quadrature"]["on"]
    assert effects["opacity"]["on"]
    assert all(str(e["why"]) for e in effects.values())
