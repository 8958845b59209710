"""Pictures of surface materials: what is known of constant ones, laws of light, and every ray by hand in float64.

Notation
ρ, E        reflectance; irradiance of a distant light on the plane facing it
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mesoshell.geometry.convex import is_convex
from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.surface import SurfaceBundle
from mesoshell.render.camera import Camera, look_at, pixel_grid, pixel_radius, rays
from mesoshell.render.effects import SURFACE, Effect, Effects, plan_effects
from mesoshell.render.light import Distant, environment
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.surface_material import renderer
from mesoshell.surface_material.intersector import SurfaceIntersector
from mesoshell.surface_material.loader import load_device_material
from mesoshell.surface_material.renderer import SurfaceScene, facts, plan, render
from mesoshell.surface_material.tables import surface_tables
from tests.helpers import wearing

EXACT = Quality(pixel_samples=1, early_stop=0.0)
RHO = np.array([0.1, 0.2, 0.3])
DOWN = Distant(np.array([0.0, 0.0, 1.0]), np.array([3.0, 2.0, 1.0]))
ASLANT = Distant(np.array([0.48, -0.6, 0.64]), np.array([1.0, 2.0, 0.5]))


def above(width: int = 12, height: int = 2, fov: float = 0.6) -> Camera:
    """Straight down on the unit square from a height, x to the right and y up."""
    return Camera(look_at((0.5, 0.5, float(height)), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0)), fov, width, width)


def scene(mesh: Mesh, b: SurfaceBundle, *lights: Distant, **more: Any) -> SurfaceScene:
    given: dict[str, Any] = {"environment": None, "base_colour": (0.5, 0.5, 0.5), "objects": (), "transparent": True}
    given |= {"camera": above(), "period": 0.5}
    return SurfaceScene(mesh=mesh, device_material=load_device_material(b), lights=lights, **(given | more))


def shown(s: SurfaceScene, quality: Quality = EXACT, convex: bool | None = None) -> tuple[np.ndarray, RenderReport]:
    return render(s, quality, planned(s, is_convex(s.mesh) if convex is None else convex))


def planned(s: SurfaceScene, convex: bool) -> Effects:
    """The plan as if the mesh were convex, or were not."""
    return plan_effects(replace(facts(s), convex=convex), EXACT, SURFACE)


def picture(s: SurfaceScene, quality: Quality = EXACT, convex: bool | None = None) -> np.ndarray:
    return shown(s, quality, convex)[0]


def test_no_ray_passes_between_faces():
    """At edges none does, at vertices four in a thousand at most: a curved sheet, from above, at what faces share."""
    mesh = wearing.grid(lambda u, v: (u, v, 0.1 * np.sin(7 * u) * np.cos(5 * v)), 20, 20)
    meets = SurfaceIntersector(surface_tables(mesh, 0.5, EXACT), np.zeros((0, 3, 3)))
    v, random = mesh.vertices.astype(np.float64), np.random.default_rng(2)
    inside = np.flatnonzero((np.abs(v[:, :2] - 0.5) < 0.49).all(axis=1))
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    edges = edges[np.isin(edges, inside).all(axis=1)]
    share = random.random((len(edges), 1))
    for place, most in ((share * v[edges[:, 0]] + (1 - share) * v[edges[:, 1]], 0.0), (v[inside], 4e-3)):
        at = np.repeat(place, 20, axis=0)
        o = at + [0.0, 0.0, 2.0] + 0.5 * random.normal(size=at.shape)
        d = (at - o) / np.linalg.norm(at - o, axis=1, keepdims=True)
        assert (meets.meet(o, d).face < 0).mean() <= most


def sheet(x0: float, x1: float, z: float) -> Mesh:
    """An object: a wide strip at a height."""
    corners = np.array([[x0, -9, z], [x1, -9, z], [x1, 9, z], [x0, 9, z]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][..., :2], "sheet")


@pytest.fixture(scope="module")
def lump() -> Mesh:
    return wearing.lump()


def test_an_opaque_constant_material_sums_its_lights() -> None:
    found = picture(scene(wearing.square(), wearing.constant(1.0, tuple(RHO)), DOWN, ASLANT))
    seen = found[..., 3] == 1
    assert 0.5 < seen.mean() < 1 and (found[~seen] == 0).all()
    wanted = RHO * (DOWN.irradiance + ASLANT.irradiance)
    np.testing.assert_allclose(found[seen][:, :3], np.broadcast_to(wanted, (seen.sum(), 3)), rtol=1e-5)


def test_an_object_hides_a_light_from_where_it_stands_before_it() -> None:
    """A strip above the camera, over the left half of a square, by light from straight above and from aside."""
    camera = above(16, 2, 0.3)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    x = (o - d * (o[:, 2:] / d[:, 2:]))[:, 0].reshape(16, 16)
    for light, edge in ((DOWN, 0.5), (Distant(np.array([0.6, 0.0, 0.8]), DOWN.irradiance), 0.5 - 3 * 0.75)):
        s = scene(wearing.square(), wearing.constant(1.0, 0.2), light, objects=(sheet(-9.0, 0.5, 3.0),), camera=camera)
        wanted = np.where((x > edge)[..., None], 0.2 * light.irradiance, 0)
        np.testing.assert_allclose(picture(s)[..., :3], wanted, rtol=1e-5)
    assert (x > 0.5).any() and (x < 0.5).any()


def test_nothing_is_seen_of_what_is_not_there() -> None:
    """α = 0 before an object, and between it and its light: it is as it is alone, which is Lambert's law."""
    ground = (sheet(-9.0, 9.0, -1.0),)
    found = picture(scene(wearing.square(), wearing.constant(0.0, 5.0), ASLANT, objects=ground))
    wanted = ASLANT.irradiance * 0.64 * 0.5 / np.pi
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(wanted, (12, 12, 3)), rtol=1e-5)
    assert (found[..., 3] == 1).all()
    alone = picture(scene(wearing.square(), wearing.constant(0.0, 5.0), ASLANT))
    assert (alone == 0).all()


def test_half_a_material_casts_half_a_shadow() -> None:
    """A ball behind the camera, on an object: half its light is left in a disc of its radius, and nothing elsewhere is lost."""
    mesh, camera = wearing.moved(wearing.ball(0.5, 64, 32), 0.5, 0.5, 3.0), above(32, 1, 0.8)
    found = picture(scene(mesh, wearing.constant(0.5, 0.2), DOWN, objects=(sheet(-9.0, 9.0, -1.0),), camera=camera))
    lit = found[..., 0] / (DOWN.irradiance[0] * 0.5 / np.pi)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    place = o - d * ((o[:, 2:] + 1) / d[:, 2:])
    off = np.hypot(*(place[:, :2] - 0.5).T).reshape(32, 32)
    np.testing.assert_allclose(lit[off < 0.49], 0.5, rtol=1e-5)
    np.testing.assert_allclose(lit[off > 0.5], 1.0, rtol=1e-5)
    assert (off < 0.49).sum() > 200 and (off > 0.5).sum() > 200 and (found[..., 3] == 1).all()


def test_bodies_are_met_once_each() -> None:
    """Half-opaque balls one behind the other: ½ and ¾; from within nothing is met. Light from the camera comes to the one
    behind through the one before it."""
    pair = wearing.joined(wearing.moved(wearing.ball(0.3), 0, 0, 2.0), wearing.ball(1.0, 64, 32))
    camera = Camera(look_at((0.0, 0.0, 12.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), 0.2, 33, 33)
    found = picture(scene(pair, wearing.constant(0.5, 0.2), DOWN, camera=camera))
    np.testing.assert_allclose(np.unique(np.round(found[..., 3], 6)), [0, 0.5, 0.75])
    np.testing.assert_allclose(found[16, 16, 3], 0.75, rtol=1e-6)
    np.testing.assert_allclose(found[16, 16, :3], (0.5 + 0.25 * 0.5) * 0.2 * DOWN.irradiance, rtol=1e-5)
    ring = (found[..., 3] > 0.4) & (found[..., 3] < 0.6)
    direct = np.isclose(found[..., 0], 0.5 * 0.2 * 3.0, rtol=1e-5)
    shaded = np.isclose(found[..., 0], 0.25 * 0.2 * 3.0, rtol=1e-5)
    assert ring.sum() > 300 and (direct | shaded)[ring].all() and direct[ring].mean() > 0.9


def stack(*sheets: Mesh) -> Mesh:
    """One below the other, the first on top, within a height of 0.8."""
    return wearing.joined(*(wearing.moved(sheet, 0, 0, -0.02 * k) for k, sheet in enumerate(sheets)))


def test_a_ray_goes_on_behind_any_number_of_sheets() -> None:
    """The light comes from where the camera is: it passes sheets from within."""
    count, alpha = 40, 0.05
    s = scene(stack(*[wearing.square()] * count), wearing.constant(alpha, tuple(RHO)), DOWN, camera=above(fov=0.2))
    found, report = shown(s)
    wanted = 1 - (1 - alpha) ** count
    np.testing.assert_allclose(found[..., 3], wanted, rtol=1e-5)
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(wanted * RHO * DOWN.irradiance, (12, 12, 3)), rtol=1e-5)
    assert report.counts["cut_short"] == 0 and not any("left out" in note for note in report.notes)


def test_light_goes_on_behind_any_number_of_sheets() -> None:
    """Sheets that the camera sees from within, and the light from outside."""
    count, alpha = 40, 0.05
    sheets = [*[wearing.turned(wearing.square())] * count, wearing.square()]
    found = picture(scene(stack(*sheets), wearing.constant(alpha, tuple(RHO)), DOWN, camera=above(fov=0.2)))
    wanted = alpha * RHO * DOWN.irradiance * (1 - alpha) ** count
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(wanted, (12, 12, 3)), rtol=1e-5)


def test_what_is_left_out_behind_too_many_surfaces_is_said(monkeypatch) -> None:
    monkeypatch.setattr(renderer, "MAX_SURFACES", 8)
    s = scene(stack(*[wearing.square()] * 12), wearing.constant(0.05, 0.1), DOWN, camera=above(fov=0.2))
    found, report = shown(s)
    np.testing.assert_allclose(found[..., 3], 1 - 0.95**8, rtol=1e-5)
    assert report.counts["cut_short"] == 144
    assert report.notes[-1] == "144 rays and shadows passed 8 surfaces; whatever lies behind these was left out"


def test_light_adds_and_scales(lump: Mesh) -> None:
    """A random material on a body that shadows itself: lights sum, one by one, and twice the light is twice the picture."""
    b, camera = wearing.bundle(), above(24, 3, 0.5)
    other = Distant(np.array([-0.8, 0.0, -0.6]), np.array([0.3, 0.9, 2.0]))

    def of(*lights: Distant) -> np.ndarray:
        return picture(scene(lump, b, *lights, camera=camera))

    one, two = of(ASLANT), of(other)
    both, double = of(ASLANT, other), of(ASLANT._replace(irradiance=2 * ASLANT.irradiance))
    assert one[..., :3].mean() > 0.01 and two[..., :3].mean() > 0.01 and one[..., 3].std() > 0.1
    np.testing.assert_allclose(both[..., :3], one[..., :3] + two[..., :3], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(double[..., :3], 2 * one[..., :3], rtol=1e-5)
    for found in (two, both, double):
        np.testing.assert_array_equal(found[..., 3], one[..., 3])


def test_light_from_below_comes_through_a_sheet() -> None:
    """A lone square is lit from below its horizon: what its body hides ρ knows. An object below it hides the light."""
    up = Distant(np.array([0.0, 0.6, -0.8]), np.ones(3))
    for objects, wanted in (((), 0.2), ((sheet(-99.0, 99.0, -0.5),), 0.0)):
        s = scene(wearing.square(), wearing.constant(1.0, 0.2), up, objects=objects, camera=above(8, 2, 0.3))
        np.testing.assert_allclose(picture(s, convex=False)[..., :3], wanted, rtol=1e-5)


def test_an_open_body_shadows_itself_from_outside() -> None:
    """A square over another hides its light by its front; from its back light comes through, as rays do."""
    low, high = wearing.square(), wearing.moved(wearing.square(), 0, 0, 3.0)
    for alpha in (1.0, 0.25):
        for roof, wanted in ((wearing.turned(high), 1 - alpha), (high, 1.0)):
            s = scene(wearing.joined(low, roof), wearing.constant(alpha, 0.2), DOWN, camera=above(8, 2, 0.3))
            found = picture(s)
            np.testing.assert_allclose(found[..., 3], alpha, rtol=1e-5)
            np.testing.assert_allclose(found[..., 0], alpha * wanted * 0.2 * 3.0, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("up", [1, 2])
def test_a_white_furnace(up: int) -> None:
    """α = 1 and ρ = 1/4π under a sky of 1: nothing can be seen, or, with the sky left out, the square alone."""
    sky = environment(np.ones((16, 32, 3), np.float32), up)
    quality = EXACT.with_changes(environment_samples=16)
    s = scene(wearing.square(), wearing.constant(1.0, 1 / (4 * np.pi)), environment=sky, transparent=False)
    found = picture(s, quality)
    np.testing.assert_allclose(found[..., :3].mean(), 1, atol=5e-3)
    np.testing.assert_allclose(found[..., :3], 1, atol=0.03)
    assert (found[..., 3] == 1).all()
    alone = picture(replace(s, transparent=True), quality)
    outside = alone[..., 3] == 0
    assert outside.any() and (alone[outside] == 0).all()
    np.testing.assert_allclose(alone[~outside][:, :3].mean(), 1, atol=5e-3)


@pytest.mark.parametrize("up", [1, 2])
def test_a_bright_spot_in_the_sky_is_a_distant_light(lump: Mesh, up: int) -> None:
    """In its direction, of its irradiance; what comes through half a material shows the sky."""
    h, w, row, column = 64, 128, 12, 26
    image = np.zeros((h, w, 3), np.float32)
    image[row, column] = [900, 700, 500]
    edges = np.cos(np.array([row, row + 1]) / h * np.pi)
    solid = (edges[0] - edges[1]) * 2 * np.pi / w
    z, phi = edges.mean(), (0.5 - (column + 0.5) / w) * 2 * np.pi
    x, y = np.sqrt(1 - z * z) * np.array([np.cos(phi), np.sin(phi)])
    toward = np.array([x, y, z]) if up == 2 else np.array([x, z, -y])
    b, camera = wearing.bundle(), above(16, 3, 0.5)
    light = Distant(toward, image[row, column] * solid)
    sky = environment(image, up)
    one = picture(scene(lump, b, light, camera=camera))
    two = picture(scene(lump, b, environment=sky, camera=camera), EXACT.with_changes(environment_samples=64))
    assert one[..., :3].mean() > 0.02
    np.testing.assert_allclose(two[..., :3].mean(axis=(0, 1)), one[..., :3].mean(axis=(0, 1)), rtol=0.05)
    assert np.abs(two - one)[..., :3].mean() < 0.1 * one[..., :3].mean()


def test_a_sky_is_seen_through_what_is_not_opaque() -> None:
    image = np.random.default_rng(0).uniform(0.5, 2, (16, 32, 3)).astype(np.float32)
    s = scene(wearing.square(), wearing.constant(0.25, 1e-12), environment=environment(image, 2), transparent=False)
    s = replace(s, camera=above(8, 2, 0.3))
    bare = picture(replace(s, mesh=wearing.moved(s.mesh, 0, 0, 99.0)))
    assert bare[..., :3].min() > 0.4
    np.testing.assert_allclose(picture(s)[..., :3], 0.75 * bare[..., :3], rtol=1e-5)


def test_shadows_that_are_off_change_nothing() -> None:
    """A convex body of few faces, by light from all sides: no light is lost on a face to the face itself, though normals are
    interpolated."""
    mesh = wearing.ball(0.6, 7, 5)
    assert is_convex(mesh)
    random = np.random.default_rng(3)
    lights = [Distant(x, np.ones(3)) for x in wearing.directions(random, 6)]
    for b in (wearing.constant(1.0, 0.1), wearing.bundle()):
        s = scene(mesh, b, *lights, camera=Camera(look_at((1.9, -2.0, 1.0), (0.0, 0.0, 0.0)), 0.5, 24, 24))
        off, on = planned(s, True), planned(s, False)
        assert not off.mesh_shadow.on and on.mesh_shadow.on
        one, two = (render(s, EXACT, e)[0] for e in (off, on))
        assert one[..., :3].mean() > 0.01
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9)


def test_opacity_that_is_off_changes_nothing(lump: Mesh) -> None:
    s = scene(lump, wearing.bundle(opacity="none"), ASLANT, camera=above(16, 3, 0.5))
    effects = planned(s, False)
    assert not effects.opacity.on and effects.mesh_shadow.on
    off = render(s, EXACT, effects)[0]
    on = render(s, EXACT, replace(effects, opacity=Effect(True, "for the test")))[0]
    np.testing.assert_array_equal(off, on)
    assert set(np.unique(off[..., 3])) == {0.0, 1.0} and len(np.unique(off[..., 0])) > 20


def test_without_light_opacity_alone_is_asked_for(lump: Mesh) -> None:
    dark, lit = scene(lump, wearing.bundle()), scene(lump, wearing.bundle(), DOWN)
    (image, report), (other, _) = shown(dark), shown(lit)
    assert (image[..., :3] == 0).all() and report.counts.get("transport_queries", 0) == 0
    np.testing.assert_allclose(image[..., 3], other[..., 3], atol=1e-6)
    assert 0 < image[..., 3].mean() < 1


def test_the_plan_says_why() -> None:
    sky = environment(np.ones((4, 8, 3), np.float32), 2)
    for more, on in (
        ({}, set()),
        ({"objects": (sheet(0.0, 1.0, 3.0),)}, {"object_shadow"}),
        ({"environment": sky}, {"environment"}),
        ({"environment": sky, "transparent": False}, {"environment", "background"}),
    ):
        said = plan(scene(wearing.square(), wearing.bundle(), DOWN, **more), EXACT).as_dict()
        assert {name for name, e in said.items() if e["on"]} == on | {"surface_materials", "opacity", "direct_light"}
        assert all(isinstance(e["on"], bool) and str(e["why"]) for e in said.values())


@pytest.mark.parametrize("distance", [3.0, 30.0, 1000.0])
def test_objects_are_lit_however_far_the_camera(distance: float) -> None:
    """No surface shadows itself because a distance is rounded: Lambert's law on a wide sheet, ρ E on a square."""
    camera = Camera(look_at((0.5, 0.5, distance), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0)), 1.0 / distance, 8, 8)
    beside = wearing.moved(wearing.square(), 5.0, 0, 0)
    one = picture(scene(beside, wearing.constant(1.0, 0.2), DOWN, objects=(sheet(-2.0, 2.0, 0.0),), camera=camera))
    np.testing.assert_allclose(one[..., 0], 3.0 * 0.5 / np.pi, rtol=1e-5)
    two = picture(scene(wearing.square(), wearing.constant(1.0, 0.2), DOWN, ASLANT, camera=camera), convex=False)
    seen = two[..., 3] > 0
    assert seen.sum() > 10
    np.testing.assert_allclose(two[seen][:, 0], 0.2 * 4.0, rtol=1e-5)


def test_an_empty_picture_is_empty() -> None:
    away = Camera(look_at((0.5, 0.5, 2.0), (0.5, 0.5, 9.0), (0.0, 1.0, 0.0)), 0.5, 6, 4)
    shares: list[float] = []
    s = scene(wearing.square(), wearing.bundle(), DOWN, camera=away)
    found, report = render(s, EXACT, plan(s, EXACT), shares.append)
    assert found.shape == (4, 6, 4) and (found == 0).all()
    assert report.counts["rays"] == 24 and report.counts.get("queries", 0) == 0
    assert shares == sorted(shares) and shares[-1] == 1


def test_pictures_are_repeated_to_the_bit(lump: Mesh) -> None:
    """Also under a sky, from which directions are drawn."""
    image = np.random.default_rng(0).uniform(0, 2, (8, 16, 3)).astype(np.float32)
    s = scene(lump, wearing.bundle(), environment=environment(image, 2), camera=above(8, 3, 0.5), transparent=False)
    one, two = (picture(s, Quality(pixel_samples=2)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.std() > 0.01


def test_curvature_that_was_not_trained_is_said() -> None:
    narrow = wearing.constant(1.0, 0.2, curvature=(-0.1, 0.1))
    s = scene(wearing.ball(0.5), narrow, DOWN, period=0.4)
    report = shown(s)[1]
    assert any("outside the trained -0.1 to 0.1 per period" in note for note in report.notes)
    assert shown(replace(s, device_material=load_device_material(wearing.constant(1.0, 0.2))))[1].notes == ()


def test_footprints_choose_the_level() -> None:
    """A pixel's standard deviation at the hit, in periods: where it holds many, between levels, and where it holds a texel."""
    b, spread = wearing.bundle(opacity="none"), []
    for period, widths in ((0.01, (8, 99)), (0.12, (2.2, 3.8)), (2.0, (0, 1))):  # of ± one deviation, in texels
        s = scene(wearing.square(), b, DOWN, period=period, camera=above(8, 2, 0.3))
        o, d = rays(s.camera, pixel_grid(s.camera, 1, 0))
        t = -o[:, 2] / d[:, 2]
        radius = pixel_radius(s.camera.spread) / 2 * t / period
        assert (widths[0] < 2 * radius * 8).all() and (2 * radius * 8 < widths[1]).all()
        u = (o + d * t[:, None])[:, :2] / period
        *_, rho = wearing.answers(b, u, radius, -d, np.zeros(64), np.tile([0, 0, 1.0], (64, 1)))
        found = picture(s)[..., :3].reshape(64, 3)
        np.testing.assert_allclose(found, rho * DOWN.irradiance, rtol=2e-3, atol=1e-3)
        spread.append(found[:, 0].std())
    assert spread[1] > 2 * spread[0]


def test_every_ray_by_hand(lump: Mesh) -> None:
    """A random material on a body that is not convex, an object, two lights: each ray followed in float64, hit by hit, and from
    each hit each light; what is asked at a hit is a SurfaceIntersector's, and what is answered the description's."""
    b = wearing.bundle(seed=4, curvature=(-0.5, 0.5))
    camera = Camera(look_at((1.8, -1.6, 1.2), (0.5, 0.5, 0.0), (0.0, 0.0, 1.0)), 0.75, 10, 10)
    other = Distant(np.array([-0.6, 0.64, 0.48]), np.array([0.5, 1.0, 2.0]))
    s = scene(lump, b, ASLANT, other, camera=camera, period=2.0, objects=(sheet(-0.2, 0.1, -0.9),))
    found = picture(s)
    intersector = SurfaceIntersector(
        surface_tables(lump, 2.0, EXACT), np.concatenate([m.vertices[m.faces].astype(np.float64) for m in s.objects])
    )
    spread = pixel_radius(camera.spread) / 2

    def followed(o: np.ndarray, d: np.ndarray, cone: float | None):
        """Hits from the ray's start on: distance, α or 1 of an object, the queries, and whether it is an object."""
        t = 0.0
        while True:
            hits = intersector.meet((o + t * d)[None], d[None])
            if hits.face[0] < 0:
                return
            at = t + hits.t[0]
            t = at + 1e-5
            if hits.face[0] >= intersector.count:
                yield at, intersector.facing(hits, np.array([0]), d[None])[0], None
            elif hits.front[0]:
                radius = spread * at if cone is None else cone
                local = intersector.queries(hits, np.array([0]), d[None], np.array([radius]))
                yield at, intersector.normal[hits.face[0]], local

    def asked(local, light: np.ndarray) -> tuple[float, np.ndarray]:
        toward = local.axes[0] @ light
        alpha, _, rho = wearing.answers(b, local.u, local.radius, local.w, local.kappa, toward[None])
        return float(alpha[0]), rho[0]

    def visible(x: np.ndarray, normal: np.ndarray, light: np.ndarray, cone: float) -> float:
        through = 1.0
        for _, _, local in followed(x + np.sign(normal @ light) * 1e-4 * normal, light, cone):
            through *= 0.0 if local is None else 1 - asked(local, light)[0]
        return through

    wanted = []
    for o, d in zip(*rays(camera, pixel_grid(camera, 1, 0)), strict=True):
        rgb, through = np.zeros(3), 1.0
        for t, normal, local in followed(o, d, None):
            x, alpha, light = o + t * d, 1.0, np.zeros(3)
            for lamp in s.lights:
                if local is None:
                    value = max(normal @ lamp.direction, 0) * np.full(3, 0.5 / np.pi)
                else:
                    alpha, value = asked(local, lamp.direction)
                light += value * lamp.irradiance * visible(x, normal, lamp.direction, spread * t)
            rgb, through = rgb + through * alpha * light, through * (1 - alpha)
            if local is None:
                break
        wanted.append([*rgb, 1 - through])
    wanted = np.array(wanted).reshape(10, 10, 4)
    assert ((wanted[..., 3] > 0.05) & (wanted[..., 3] < 0.95)).mean() > 0.2
    off = np.abs(found - wanted).max(axis=-1)
    assert np.sort(off.ravel())[-3] < 2e-3 * wanted[..., :3].max()  # a ray or two may pass an edge on its other side
    assert np.median(off) < 1e-4
