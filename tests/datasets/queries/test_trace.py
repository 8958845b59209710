"""Light in mesostructures: against cylinders by hand, and the laws that light keeps in any of them.

With radius 0 and dim surfaces nothing is random: what is lit directly is compared exactly, bounces by their means.
"""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from mesoshell.datasets.queries.sources import HIGH, of_heights, source
from mesoshell.datasets.queries.tile import REACH, PatchPlacement, Tile
from mesoshell.datasets.queries.trace import AWAY, Patch, normal_lattice, queries

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

BODY = (0.6, 0.3, 0.1)
NEAR = (1.3, 1.3)


def bare(depth: float, body: tuple[float, float, float] = BODY) -> Tile:
    """Nothing but a body: the one triangle lies under it."""
    points = np.array([[0.4, 0.4, -1.5 * depth], [0.6, 0.4, -1.5 * depth], [0.4, 0.6, -1.5 * depth]])
    return Tile(points, np.array([[0, 1, 2]]), np.ones((3, 3)), depth, body)


def sheet(cells: int, height: float, depth: float, edge: bool = False) -> Tile:
    """A level sheet whose albedo is (u, v, 0.5); with an edge: black where u < 0.5, and white beyond."""
    first = np.arange(cells) / cells
    u = first[:, None, None] + np.array([0, 1, 1, 0, 1, 0]) / cells + 0 * first[:, None]
    v = first[:, None] + np.array([0, 0, 1, 0, 1, 1]) / cells + 0 * first[:, None, None]
    points = np.stack([u, v, np.full_like(u, height)], -1).reshape(-1, 3)
    albedo = np.stack([points[:, 0], points[:, 1], np.full(len(points), 0.5)], -1)
    if edge:
        beyond = np.repeat(u.mean(axis=-1).ravel() > 0.5, 6)
        albedo = np.broadcast_to(beyond[:, None], points.shape).astype(float)
    return Tile(points, np.arange(len(points)).reshape(-1, 3), albedo, depth, (0.0, 0.0, 0.0))


def hills(dim: float = 1.0) -> Tile:
    """A height field whose period has no symmetry."""
    v, u = ((np.arange(16) + 0.5) / 16 * 2 * np.pi for _ in range(2))
    image = np.sin(u) + 0.7 * np.sin(2 * v[:, None] + u) + 0.4 * np.cos(u - v[:, None])
    return dimmed(of_heights(image.astype(np.float32), 0.15), dim)


def dimmed(tile: Tile, dim: float) -> Tile:
    r, g, b = (dim * c for c in tile.body)
    return replace(tile, albedo=tile.albedo * dim, body=(r, g, b))


def white(tile: Tile) -> Tile:
    return replace(tile, albedo=np.ones_like(tile.albedo), body=(1.0, 1.0, 1.0))


def sphere(count: int, random: np.random.Generator, least: float = -1.0, most: float = 1.0) -> np.ndarray:
    """Unit vectors, z uniform between bounds."""
    z, angle = random.uniform(least, most, count), random.uniform(0, 2 * np.pi, count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)


def across(cosine: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Directions across the axis, from either side."""
    sine = np.sqrt(1 - cosine**2) * random.choice([-1, 1], len(cosine))
    return np.stack([sine, 0 * cosine, cosine], -1)


def ask(
    patch: Patch, placing: PatchPlacement, toward, light, place=None, radius: float = 0.0, spp: int = 1, seed: int = 0
):
    """Answers to queries; by default where the patch has its middle."""
    toward, light = np.broadcast_arrays(np.asarray(toward, float), np.asarray(light, float))
    toward, light = (np.atleast_2d(x) for x in (toward, light))
    place = np.broadcast_to(np.zeros(2) if place is None else place, (len(toward), 2))
    asked = {"place": place, "radius": np.full(len(toward), radius), "toward": toward, "light": light}
    return queries(patch, placing, asked, spp, seed)


def about(tile: Tile, curvature: float, reach: tuple[float, float] = NEAR, **more) -> tuple[Patch, PatchPlacement]:
    placing = PatchPlacement(curvature, **more)
    return Patch(tile, placing, reach), placing


def on_the_body(curvature: float, depth: float, toward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether rays against `toward` through the origin meet the body, and the normal there against them, in float64."""
    radius, axis = abs(1 / curvature - depth), np.array([0.0, -1 / curvature])
    flat = toward[:, [0, 2]]
    b, c = flat @ axis, axis @ axis - radius**2
    root = b**2 - (flat**2).sum(axis=1) * c
    t = (b + np.sign(curvature) * np.sqrt(np.maximum(root, 0))) / (flat**2).sum(axis=1)
    normal = (t[:, None] * flat - axis) / radius * np.sign(curvature)
    return root > 0, np.stack([normal[:, 0], 0 * t, normal[:, 1]], -1)


def test_a_level_body_is_a_lambertian_plane():
    """All rays meet it and nothing lies between: albedo / π · ω′_z, and no light from below."""
    random = np.random.default_rng(0)
    toward, light = sphere(4000, random, 0.03), sphere(4000, random)
    patch, placing = about(bare(0.1), 0.0, turn=0.4, shift=(0.1, 0.2))
    found = ask(patch, placing, toward, light, random.uniform(-0.5, 0.5, (4000, 2)), radius=0.1, spp=2)
    assert (found["alpha"] == 1).all()
    np.testing.assert_allclose(
        found["reflectance"], np.array(BODY) / np.pi * np.maximum(light[:, 2:], 0), rtol=1e-5, atol=1e-9
    )
    assert (found["cosine"] <= 0.1 / REACH * 1.1).all()


@pytest.mark.parametrize("curvature", [0.2, 1.0, 3.0])
def test_a_body_seen_from_outside_is_a_lambertian_cylinder(curvature: float):
    """It is convex: light reaches each point on its own side, from below the horizon too, and none of it twice."""
    random, depth = np.random.default_rng(1), 0.12
    edge = np.sqrt(1 - (1 - curvature * depth) ** 2)
    toward = across(random.uniform(0.03, 1, 6000), random)
    light = np.concatenate([sphere(3000, random), sphere(3000, random, -0.3, 0.3)])
    patch, placing = about(bare(depth), curvature)
    found = ask(patch, placing, toward, light)
    sure = np.abs(toward[:, 2] - edge) > 1e-3
    met, normal = on_the_body(curvature, depth, toward)
    np.testing.assert_array_equal(met[sure], toward[sure, 2] > edge)
    np.testing.assert_array_equal(found["alpha"][sure, 0], met[sure])
    cosine = np.where(met, np.maximum((normal * light).sum(axis=1), 0), 0)
    error = np.abs(found["reflectance"] - np.array(BODY) / np.pi * cosine[:, None])[sure]
    # flat strips: the normal is off by half of one
    assert error.max() < BODY[0] / np.pi * (np.pi / 1024 + 1e-3)
    below = sure & met & (light[:, 2] < 0)
    assert (found["reflectance"][below, 0] > 0.002).sum() > 20 and (found["reflectance"][below, 0] == 0).sum() > 20


def test_the_far_side_of_a_cylinder_by_hand():
    """Radius 1 and D = 1/2: a ray with sin = 0.4 passes the axis at 0.4, so that cos = 0.6 where it meets the body; that is at
    (−0.247, 0.435) from the axis."""
    patch, placing = about(bare(0.5), 1.0)
    view = [0.4, 0.0, np.sqrt(0.84)]
    lights = [view, [-1.0, 0, 0], [-0.9, 0, -np.sqrt(0.19)], [1.0, 0, 0], [0.0, 1, 0], [0.0, 0, -1], [-0.6, 0.8, 0]]
    f = BODY[0] / np.pi
    found = ask(patch, placing, view, lights)
    assert (found["alpha"] == 1).all()
    expected = [0.6, 0.49317, 0.06462, 0, 0, 0, 0.6 * 0.49317]
    np.testing.assert_allclose(found["reflectance"][:, 0] / f, expected, atol=0.004)
    assert (found["reflectance"][3:6] == 0).all()
    np.testing.assert_allclose(found["cosine"], np.sqrt(0.75), atol=2e-4)


@pytest.mark.parametrize(
    ("curvature", "height"),
    [(0.02, None), (0.2, None), (1.0, None), (3.0, None), (0.2, -0.05), (1.0, -0.05), (3.0, -0.05)],
)
def test_the_silhouette_cosine(curvature: float, height: float | None):
    """Of a cylinder 1 / κ − D, or 1 / κ + h of a sheet on it: a ray that passes its axis at that distance."""
    tile = bare(0.12) if height is None else sheet(48, height, 0.12)
    patch, placing = about(tile, curvature, (2.5, 0.5))
    random = np.random.default_rng(2)
    toward = across(random.uniform(0.03, 1, 50), random)
    place = random.uniform([-0.3, -0.3], 0.3, (50, 2))
    found = ask(patch, placing, toward, [0.0, 0, 1], place)["cosine"]
    far = 1 - curvature * (0.12 if height is None else -height)
    # corners of flat cells lie on the cylinder, their middles below it
    cell = 0 if height is None else (curvature / 48) ** 2 / 8
    np.testing.assert_allclose(found, np.sqrt(1 - far**2), atol=3e-4 + 2 * cell / np.sqrt(1 - far**2))


def test_rays_meet_something_just_above_the_silhouette_cosine_and_nothing_just_below():
    random = np.random.default_rng(3)
    patch, placing = about(hills(), 1.5, (2.0, 1.3))
    place, toward = random.uniform(-0.5, 0.5, (400, 2)), across(random.uniform(0.03, 1, 400), random)
    cosine = ask(patch, placing, toward, [0.0, 0, 1], place)["cosine"][:, 0].astype(float)
    assert cosine.min() > 0.01 and np.ptp(cosine) > 0.1
    for step, meets in ((3e-4, 1), (-3e-4, 0)):
        c = cosine + step
        turned = np.stack([np.sign(toward[:, 0]) * np.sqrt(1 - c**2), 0 * c, c], -1)
        assert (ask(patch, placing, turned, [0.0, 0, 1], place)["alpha"] == meets).mean() > 0.98


def test_the_silhouette_cosine_is_that_of_the_rays_own_side():
    """A ray of cosine c comes out again at an angle of 2 asin c, and goes below all that stands before. A ridge stands 7/32 to
    the left of the middle, and the next one 25/32 to its right."""
    image = np.zeros((1, 16), np.float32)
    image[0, 4] = 1
    patch, placing = about(of_heights(image, 0.2), 1.0, (1.0, 1.0), shift=(0.5, 0.0))
    sides = np.array([[-0.6, 0, 0.8], [0.6, 0, 0.8]])
    found = ask(patch, placing, sides, [0.0, 0, 1])["cosine"][:, 0]
    # the viewer on the left looks to the right
    np.testing.assert_allclose(found, [np.sin(25 / 64), np.sin(7 / 64)], atol=1e-3)


def test_inside_a_cylinder_every_ray_meets_something():
    random = np.random.default_rng(4)
    for tile in (bare(0.12), hills()):
        patch, placing = about(tile, -1.0)
        found = ask(patch, placing, across(random.uniform(0.03, 1, 2000), random), sphere(2000, random))
        assert (found["alpha"] == 1).all() and (found["cosine"] == 0).all()


@pytest.mark.parametrize("curvature", [-0.3, -1.0, -4.0])
def test_a_body_seen_from_within_is_lit_through_its_bounding_surface(curvature: float):
    """Light that reaches a point after it has passed the bounding surface is not blocked by the other side; that which
    would come along the body, under the bounding surface, is."""
    random, depth = np.random.default_rng(5), 0.12
    patch, placing = about(bare(depth, (1e-4, 1e-4, 1e-4)), curvature)
    toward, light = across(random.uniform(0.03, 1, 6000), random), sphere(6000, random)
    found = ask(patch, placing, toward, light)["reflectance"][:, 0] * np.pi / 1e-4
    _, normal = on_the_body(curvature, depth, toward)
    cosine = (normal * light).sum(axis=1)
    # in the plane across the axis: a chord of the circle 1/|κ| + D stays outside 1/|κ| if it is this flat
    level = np.linalg.norm(light[:, [0, 2]], axis=1)
    sine = np.sqrt(np.maximum(1 - (cosine / level) ** 2, 0))
    leaves = sine * (1 - curvature * depth)
    sure = (np.abs(leaves - 1) > 0.01) & (np.abs(cosine) > 0.01)
    lit = (cosine > 0) & (leaves < 1)
    assert (sure & lit).sum() > 1000 and (sure & (cosine > 0.05) & ~lit).sum() > 100
    np.testing.assert_allclose(found[sure], np.where(lit, cosine, 0)[sure], atol=0.005)


@pytest.mark.parametrize("curvature", [-0.2, -1.0, -3.0])
def test_where_rays_leave(curvature: float):
    """The first root of the quadratic in float64, of rays that come from between the bounding surface and the body."""
    random, inner = np.random.default_rng(6), -1 / curvature
    patch, _ = about(bare(0.12), curvature)
    radius, angle = inner + random.uniform(0, 0.12, 5000), random.uniform(-1.5, 1.5, 5000)
    o = np.stack([radius * np.sin(angle), random.uniform(-1, 1, 5000), inner - radius * np.cos(angle)], -1)
    d = sphere(5000, random)
    o, d = (x.astype(np.float32) for x in (o, d))
    found = np.array(patch.leave(mi.Point3f(o.T.copy()), mi.Vector3f(d.T.copy())))
    at, way = o.astype(float)[:, [0, 2]] - [0, inner], d.astype(float)[:, [0, 2]]
    a, b, c = (way**2).sum(1), (at * way).sum(1), (at**2).sum(1) - inner**2
    root = b**2 - a * c
    enters = (b < 0) & (root > 0)
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    sure = (np.abs(root) > 1e-4 * b**2) & (np.abs(b) > 1e-4) & (c > 1e-5)
    assert (sure & enters).sum() > 1000 and (sure & ~enters).sum() > 1000
    assert np.isinf(found[sure & ~enters]).all()
    np.testing.assert_allclose(found[sure & enters], t[sure & enters], rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("curvature", [0.0, 0.5])
def test_nothing_leaves_a_surface_that_is_not_seen_from_within(curvature: float):
    patch, _ = about(bare(0.12), curvature)
    assert np.isinf(np.array(patch.leave(mi.Point3f(0.0, 0.0, -0.1), mi.Vector3f(0.0, 0.0, 1.0)))).all()


def test_albedo_is_linear_between_vertices_and_lies_where_the_texture_does():
    """Seen straight from above, the place is the place; at a slant it is seen where the ray gets down to the sheet."""
    random = np.random.default_rng(7)
    patch, placing = about(sheet(6, -0.05, 0.1), 0.0, turn=0.9, shift=(0.21, -0.4))
    place, toward, light = random.uniform(-0.5, 0.5, (500, 2)), sphere(500, random, 0.4), sphere(500, random, 0.2)
    toward[:100] = [0.0, 0, 1]
    found = ask(patch, placing, toward, light, place)["reflectance"]
    uv = placing.texture(place - 0.05 * toward[:, :2] / toward[:, 2:])
    expected = np.concatenate([uv % 1.0, np.full((500, 1), 0.5)], axis=1) / np.pi * light[:, 2:]
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_a_surface_is_met_from_both_sides():
    """The normal is that against the ray, albedo the same."""
    patch, _ = about(sheet(6, -0.05, 0.1), 0.0)
    sides = []
    for z in (-0.09, -0.01):
        hit, t, n, f = patch.meet(mi.Point3f(0.02, 0.03, z), mi.Vector3f(0.0, 0.0, 1.0 if z < -0.05 else -1.0))
        assert np.array(hit).all()
        np.testing.assert_allclose(np.array(t), 0.04, atol=1e-6)
        np.testing.assert_allclose(np.array(n).ravel(), [0, 0, np.sign(z + 0.05)], atol=1e-6)
        sides.append(np.array(f).ravel())
    np.testing.assert_allclose(sides[0], np.array([0.02, 0.03, 0.5]) / np.pi, atol=1e-6)
    np.testing.assert_allclose(sides[1], sides[0], atol=1e-6)


@pytest.mark.parametrize("radius", [0.02, 0.1])
def test_the_radius_is_a_standard_deviation(radius: float):
    """Beside the edge between black and white, the share of white is the normal distribution's; both ways, in any turn."""
    random = np.random.default_rng(8)
    away = random.uniform(-2, 2, 40) * radius
    for turn in (0.0, np.pi / 2):
        patch, placing = about(sheet(2, -0.01, 0.1, edge=True), 0.0, turn=turn, shift=(0.5, 0.0))
        place = np.stack([away, 0 * away], -1) if turn == 0 else np.stack([0 * away, -away], -1)
        found = ask(patch, placing, [0.0, 0, 1], np.broadcast_to([0.0, 0, 1], (40, 3)), place, radius, spp=2000)
        share = found["reflectance"][:, 0] * np.pi
        expected = np.array([NormalDist(0, radius).cdf(x) for x in away])
        z = (share - expected) / np.sqrt(np.maximum(expected * (1 - expected), 0.005) / 2000)
        assert np.abs(z).max() < 4.5 and np.abs(z.mean()) < 4 / np.sqrt(40)


def test_a_wide_query_is_the_mean_of_narrow_ones():
    """On a curved patch: places are drawn along the surface, directions are those of each place's own frame."""
    random, n = np.random.default_rng(9), 40000
    patch, placing = about(hills(), 1.5, (2.0, 1.3), turn=0.3)
    changed = []
    for toward, light in (([0.8, 0, 0.6], [-0.6, 0.6, 0.53]), ([-0.96, 0, 0.28], [-0.6, 0.8, 0.0])):
        toward = np.broadcast_to(toward, (n, 3))
        wide = ask(patch, placing, toward, light, [0.1, -0.2], 0.15, seed=1)
        narrow = [0.1, -0.2] + 0.15 * random.standard_normal((n, 2))
        means = ask(patch, placing, toward, light, narrow, seed=2)
        point = ask(patch, placing, toward, light, [0.1, -0.2], seed=3)
        for name in ("alpha", "reflectance"):
            a, b, c = (x[name][:, 0].astype(float) for x in (wide, means, point))
            error = np.sqrt((a.var() + b.var()) / n) + 1e-6
            assert abs(a.mean() - b.mean()) < 4 * error, name
            changed.append(abs(b.mean() - c.mean()) / error)
    assert sum(x > 20 for x in changed) >= 2, "the mean is not the middle"


@pytest.mark.parametrize("curvature", [0.0, 1.5, -0.8])
def test_the_patchs_middle_may_lie_anywhere(curvature: float):
    """A place off the middle is the middle of a patch that is shifted there; on a cylinder its frame is turned with it."""
    random, n, turn = np.random.default_rng(10), 300, 0.7
    place = np.array([0.4, -0.3])
    toward, light = across(random.uniform(0.03, 1, n), random), sphere(n, random)
    tile, wide = hills(1e-4), (2.4, 1.8)
    first, second = PatchPlacement(curvature, turn, (0.2, 0.9)), PatchPlacement(curvature, turn)
    a, b = first.texture(place)
    second = PatchPlacement(curvature, turn, (float(a), float(b)))
    here = ask(Patch(tile, first, wide), first, toward, light, place)
    there = ask(Patch(tile, second, wide), second, toward, light)
    other = ask(Patch(tile, first, wide), first, toward, light)
    for name, much in (("alpha", 0.5), ("cosine", 1e-3), ("reflectance", 1e-7)):
        agree = (np.abs(here[name] - there[name]) < much).all(axis=1).mean()
        assert agree > 0.98, name
    assert (np.abs(here["reflectance"] - other["reflectance"]) < 1e-7).all(axis=1).mean() < 0.7


def test_turning_patch_view_and_light_changes_nothing():
    """Flat, the same (u, v), ω and ω′ in the frame of (u, v): no matter how the patch is turned."""
    random, n = np.random.default_rng(11), 300
    uv, toward, light = random.random((n, 2)), sphere(n, random, 0.2), sphere(n, random)
    found = []
    for turn, shift in ((0.0, (0.5, 0.5)), (0.8, (0.3, 0.6)), (np.pi, (0.6, 0.4)), (4.0, (0.5, 0.5))):
        c, s = np.cos(turn), np.sin(turn)
        back = np.array([[c, -s], [s, c]])
        placing = PatchPlacement(0.0, turn, shift)
        w, l = (np.concatenate([x[:, :2] @ back, x[:, 2:]], axis=1) for x in (toward, light))
        place = (uv - np.array(shift)) @ back
        np.testing.assert_allclose(placing.texture(place), uv)
        found.append(ask(Patch(hills(1e-4), placing, (2.4, 2.4)), placing, w, l, place)["reflectance"])
    for other in found[1:]:
        assert (np.abs(other - found[0]) < 1e-7).all(axis=1).mean() > 0.98
    assert (found[0][:, 0] > 1e-6).sum() > 100 and np.ptp(found[0][:, 0] / np.maximum(light[:, 2], 0.05)) > 1e-5


@pytest.mark.parametrize(("name", "curvature"), [("spheres", 0.0), ("spheres", -0.8), ("scales", 1.5)])
def test_a_white_furnace(name: str, curvature: float):
    """White surfaces under light from everywhere: what is met cannot be told from the sky, no light is lost or found."""
    random, n = np.random.default_rng(12), 30000
    patch, placing = about(white(source(name)), curvature, (1.5, 1.5), turn=0.3)
    for cosine in (0.95, 0.5, 0.15):
        place = random.uniform(-0.5, 0.5, (n, 2))
        found = ask(patch, placing, across(np.full(n, cosine), random), sphere(n, random), place)
        gain = 4 * np.pi * found["reflectance"][:, 0].astype(float) - found["alpha"][:, 0]
        assert found["alpha"].mean() > 0.05
        assert abs(gain.mean()) < 4 * gain.std() / np.sqrt(n) < 0.06, cosine


def test_a_flat_surface_gets_no_light_from_below_and_all_of_the_upper_hemispheres():
    """The same furnace by halves: 2π times the mean of the upper one is 1, the lower one is 0."""
    random, n = np.random.default_rng(13), 30000
    patch, placing = about(white(source("spheres")), 0.0, (1.5, 1.5))
    place, toward = random.uniform(-0.5, 0.5, (n, 2)), sphere(n, random, 0.3)
    above = ask(patch, placing, toward, sphere(n, random, 0.0), place)["reflectance"][:, 1].astype(float)
    assert abs(2 * np.pi * above.mean() - 1) < 4 * 2 * np.pi * above.std() / np.sqrt(n) < 0.06
    below = ask(patch, placing, toward, sphere(n, random, most=-0.01), place)["reflectance"]
    assert (below == 0).all()


@pytest.mark.parametrize("name", ["spheres", "scales"])
def test_light_may_go_either_way(name: str):
    """Over a period, L / (E⊥ ω′_z) is a reflectance as any: reciprocal. So the mean of L / E⊥ times ω_z is the same if view
    and light change places."""
    random, n = np.random.default_rng(14), 60000
    tile = source(name)
    patch, placing = about(tile, 0.0, (2.0, 2.0))
    view, light = np.array([0.8, 0.0, 0.6]), np.array([-0.2, 0.3, np.sqrt(0.87)])
    place = random.uniform(-0.5, 0.5, (n, 2))
    there = ask(patch, placing, np.broadcast_to(view, (n, 3)), light, place, seed=1)["reflectance"].astype(float)
    back = ask(patch, placing, np.broadcast_to(light, (n, 3)), view, place, seed=2)["reflectance"].astype(float)
    error = np.sqrt((there * view[2]).var(axis=0) + (back * light[2]).var(axis=0)) / np.sqrt(n)
    assert (np.abs((there * view[2]).mean(axis=0) - (back * light[2]).mean(axis=0)) < 4 * error).all()
    assert (np.abs(there.mean(axis=0) - back.mean(axis=0)) > 8 * error).all(), "without the cosines it would not hold"


def test_bounces_add_light():
    """Bright hills are brighter by more than their albedo: what they see of each other."""
    random, n = np.random.default_rng(15), 20000
    place, light = random.uniform(-0.5, 0.5, (n, 2)), sphere(n, random, 0.0)
    means = []
    for dim in (1e-3, 1.0):
        patch, placing = about(dimmed(white(hills()), dim), 0.0)
        found = ask(patch, placing, np.broadcast_to([0.0, 0, 1], (n, 3)), light, place)
        means.append(found["reflectance"].mean() / dim * 2 * np.pi)
    direct, all_of_it = means
    assert 0.6 < direct < 0.95 and abs(all_of_it - 1) < 0.03


def test_a_seed_is_an_answer():
    random = np.random.default_rng(16)
    patch, placing = about(source("spheres"), 1.0, (1.0, 1.0))
    toward, light = across(random.uniform(0.2, 1, 500), random), sphere(500, random)
    one, two, other = (ask(patch, placing, toward, light, radius=0.1, spp=2, seed=k) for k in (5, 5, 6))
    for name, shape in (("alpha", (500, 1)), ("cosine", (500, 1)), ("reflectance", (500, 3))):
        np.testing.assert_array_equal(one[name], two[name])
        assert one[name].shape == shape and one[name].dtype == np.float32
    assert (one["reflectance"] != other["reflectance"]).mean() > 0.2


def test_a_ray_that_meets_nothing_has_no_light():
    patch, placing = about(hills(), 1.5, (2.0, 1.3))
    random = np.random.default_rng(17)
    found = ask(patch, placing, across(random.uniform(0.03, 0.4, 2000), random), sphere(2000, random))
    missed = found["alpha"][:, 0] == 0
    assert 100 < missed.sum() < 1900
    assert (found["reflectance"][missed] == 0).all() and (found["reflectance"][~missed] > 0).any()
    assert all(np.isfinite(x).all() for x in found.values())


@pytest.mark.parametrize("curvature", [0.0, 1.5, -0.8])
def test_a_plateau_at_the_bounding_surface_is_met(curvature: float):
    """Heights of an image that is white over half of its width: rays do not begin beneath what lies at h = 0."""
    random, n = np.random.default_rng(19), 2000
    image = np.repeat(np.array([[0.0, 1.0]] * 2, np.float32), 64, axis=1)
    patch, placing = about(dimmed(of_heights(image, 0.2), 1e-4), curvature, (1.0, 1.0), shift=(0.75, 0.0))
    place = random.uniform([-0.2, -0.5], [0.2, 0.5], (n, 2))
    found = ask(patch, placing, across(random.uniform(0.03, 1, n), random), [0.0, 0, 1], place)
    assert (found["alpha"] == 1).all()
    np.testing.assert_allclose(found["reflectance"], np.broadcast_to(1e-4 * np.array(HIGH) / np.pi, (n, 3)), rtol=0.002)
    assert found["cosine"].max() < 0.01


def test_a_surface_does_not_shade_itself():
    """Rays that leave it do so from AWAY above it: of a fine sheet on a cylinder, none is lost but those along it."""
    random, n = np.random.default_rng(18), 20000
    patch, placing = about(dimmed(sheet(64, -AWAY, 0.1), 1e-4), 1.0, (1.0, 1.0))
    place, light = random.uniform(-0.3, 0.3, (n, 2)), sphere(n, random, 0.1)
    found = ask(patch, placing, np.broadcast_to([0.0, 0, 1], (n, 3)), light, place)
    np.testing.assert_allclose(found["reflectance"][:, 2], 0.5e-4 / np.pi * light[:, 2], rtol=0.02, atol=0.5e-4 * 0.004)


def test_places_of_a_query_are_normal_and_lie_evenly() -> None:
    drawn = normal_lattice(8000, 16, np.random.default_rng(0))
    assert drawn.shape == (8000, 16, 2) and np.isfinite(drawn).all()
    np.testing.assert_allclose([drawn.mean(), (drawn**2).mean(), (drawn**4).mean()], [0, 1, 3], atol=0.1)
    np.testing.assert_allclose((drawn[..., 0] * drawn[..., 1]).mean(), 0, atol=0.02)
    assert drawn.mean(axis=1).std() < 0.6 / 16**0.5  # of independent numbers a quarter
