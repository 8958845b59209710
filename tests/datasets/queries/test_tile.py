"""A period bent onto a cylinder: against circles by hand, and against copies made one at a time."""

from itertools import product

import mpmath
import numpy as np
import pytest

from mesoshell.datasets.queries.tile import REACH, STRIPS, PatchPlacement, Tile, bent, frame, patch

CURVATURES = [-2.0, -0.3, 0.2, 1.7]


def sheet(cells: int, height=lambda u, v: -0.05 + 0 * u, depth: float = 0.1) -> Tile:
    """One period of a height field, on a grid; its albedo is (u, v, 0)."""
    at = np.arange(cells + 1) / cells
    u, v = (x.ravel() for x in np.meshgrid(at, at, indexing="ij"))
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1, 1)
    faces = np.concatenate([i + np.array([0, 1, cells + 2]), i + np.array([0, cells + 2, cells + 1])])
    return Tile(np.stack([u, v, height(u, v)], 1), faces, np.stack([u, v, 0 * u], 1), depth, (0.1, 0.2, 0.3))


def shreds(random: np.random.Generator) -> Tile:
    """Triangles that lie far over the border of their period."""
    corners = random.uniform(-1.5, 2.5, (6, 1, 3)) + random.uniform(-0.1, 0.1, (6, 3, 3))
    corners[..., 2] = random.uniform(-0.1, 0, (6, 3))
    return Tile(corners.reshape(-1, 3), np.arange(18).reshape(6, 3), random.random((18, 3)), 0.1, (0.1, 0.2, 0.3))


def shown(tile: Tile, placing: PatchPlacement, reach: tuple[float, float]) -> np.ndarray:
    """Corners and albedos of all triangles but the body's (n, 3, 6)."""
    points, faces, albedo = patch(tile, placing, reach)
    faces = faces[: len(faces) - 2 * STRIPS]
    return np.concatenate([points[faces], albedo[faces]], axis=-1)


def ordered(triangles: np.ndarray) -> np.ndarray:
    rows = triangles.reshape(len(triangles), -1)
    return rows[np.lexsort(np.round(rows, 6).T)]


def area(triangles: np.ndarray) -> float:
    a, b, c = (triangles[:, i, :3] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def places(count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    return random.uniform(-1.5, 1.5, (count, 2)), random.uniform(-0.3, 0, count)


@pytest.mark.parametrize("curvature", CURVATURES)
def test_points_lie_on_circles_about_the_axis(curvature: float):
    """The axis runs along y at z = −1/κ; heights add to the radius, and s is the arc on h = 0."""
    sy, h = places()
    p = bent(sy, h, curvature)
    z = p[:, 2] + 1 / curvature
    np.testing.assert_allclose(np.hypot(p[:, 0], z), np.abs(1 / curvature + h), rtol=1e-13)
    np.testing.assert_array_equal(p[:, 1], sy[:, 1])
    turned = np.angle((z + 1j * p[:, 0]) * np.sign(1 / curvature + h))
    whole = np.round((curvature * sy[:, 0] - turned) / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose((turned + whole) / curvature, sy[:, 0], atol=1e-12)
    s = np.linspace(0, 1.5, 4001)
    rail = bent(np.stack([s, 0 * s], 1), 0 * s, curvature)
    np.testing.assert_allclose(np.linalg.norm(np.diff(rail, axis=0), axis=1).sum(), 1.5, rtol=1e-6)


@pytest.mark.parametrize("curvature", [1e-12, -1e-9, 1e-6, -1e-3, 0.5])
def test_almost_flat_is_as_exact_as_curved(curvature: float):
    """Against sin and cos in 50 digits, where (1 − cos κs) / κ as it is written would lose all of them."""
    sy, h = places(20)
    with mpmath.workdps(50):
        k = mpmath.mpf(curvature)
        for (s, _), height, p in zip(sy, h, bent(sy, h, curvature), strict=True):
            x, z = (1 / k + height) * mpmath.sin(k * s), (1 / k + height) * mpmath.cos(k * s) - 1 / k
            np.testing.assert_allclose(p[[0, 2]], [float(x), float(z)], rtol=1e-13, atol=1e-16)


def test_flat_is_the_limit_of_curved():
    sy, h = places()
    flat = bent(sy, h, 0.0)
    np.testing.assert_array_equal(flat, np.column_stack([sy, h]))
    for curvature in (1e-9, -1e-9):
        np.testing.assert_allclose(bent(sy, h, curvature), flat, atol=2e-9)
        np.testing.assert_allclose(frame(sy, curvature), frame(sy, 0.0), atol=2e-9)
    np.testing.assert_array_equal(frame(sy, 0.0), np.broadcast_to(np.eye(3), (len(sy), 3, 3)))


@pytest.mark.parametrize("curvature", [*CURVATURES, 0.0])
def test_a_frame_is_the_derivative_of_places(curvature: float):
    sy, _ = places()
    axes, e = frame(sy, curvature), 1e-5
    rows = []
    for step in (np.array([e, 0]), np.array([0, e])):
        rows.append(bent(sy + step, np.zeros(len(sy)), curvature) - bent(sy - step, np.zeros(len(sy)), curvature))
    rows.append(bent(sy, np.full(len(sy), e), curvature) - bent(sy, np.full(len(sy), -e), curvature))
    np.testing.assert_allclose(axes, np.stack(rows, 1) / (2 * e), atol=1e-9)
    np.testing.assert_allclose(axes @ axes.swapaxes(1, 2), np.broadcast_to(np.eye(3), axes.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(axes), 1, atol=1e-14)


def test_unturned_and_flat_it_is_the_tiles_copies():
    """Two periods by four about the middle, each number as the tile has it."""
    tile = sheet(4, lambda u, v: -0.1 * u * v)
    found = shown(tile, PatchPlacement(0.0), (1.0, 2.0))
    corners = np.concatenate([tile.vertices[tile.faces], tile.albedo[tile.faces]], axis=-1)
    copies = [corners + np.array([i, j, 0, 0, 0, 0]) for i in (-1, 0) for j in (-2, -1, 0, 1)]
    np.testing.assert_array_equal(ordered(found), ordered(np.concatenate(copies)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("curvature", [0.0, 0.9, -0.9])
def test_no_copy_within_reach_is_left_out(seed: int, curvature: float):
    """Of triangles that overhang their period by more than one, turned and shifted: against all copies, one at a time."""
    random = np.random.default_rng(seed)
    tile, reach = shreds(random), tuple(random.uniform(0.3, 2.0, 2))
    placing = PatchPlacement(curvature, random.uniform(0, 2 * np.pi), tuple(random.uniform(-3, 3, 2)))
    back, expected = np.exp(-1j * placing.turn), []
    for i, j in product(range(-12, 13), repeat=2):
        moved = tile.vertices[:, :2] + [i, j] - np.array(placing.shift)
        sy = (moved[:, 0] + 1j * moved[:, 1]) * back
        for face in tile.faces:
            middle = sy[face].mean()
            if abs(middle.real) <= reach[0] and abs(middle.imag) <= reach[1]:
                points = bent(np.stack([sy[face].real, sy[face].imag], -1), tile.vertices[face, 2], curvature)
                expected.append(np.concatenate([points, tile.albedo[face]], axis=-1))
    assert len(expected) > 3
    np.testing.assert_allclose(ordered(shown(tile, placing, reach)), ordered(np.array(expected)), atol=1e-12)


def test_area_grows_with_the_number_of_periods():
    """Wherever the patch lies on the texture, as long as it is a whole number of periods wide."""
    tile = sheet(8, lambda u, v: -0.05 * (1 + np.sin(2 * np.pi * u) * np.cos(2 * np.pi * v)))
    one = area(np.concatenate([tile.vertices[tile.faces]] * 2, axis=-1))
    assert one > 1.02
    for reach, shift in (((0.5, 0.5), (0.31, 0.17)), ((1.0, 0.5), (-0.6, 2.3)), ((2.0, 1.5), (0.01, 0.44))):
        found = area(shown(tile, PatchPlacement(0.0, shift=shift), reach))
        np.testing.assert_allclose(found, 4 * reach[0] * reach[1] * one, rtol=1e-12)


def test_a_quarter_turn_and_whole_periods():
    """Turned by 90° the geometry is turned back by 90°; shifted by whole periods it is itself."""
    tile, reach = sheet(5, lambda u, v: -0.1 * u), (1.4, 1.4)
    plain = shown(tile, PatchPlacement(0.0, 0.0, (0.03, 0.04)), reach)
    turned = plain.copy()
    turned[..., 0], turned[..., 1] = plain[..., 1], -plain[..., 0]
    found = shown(tile, PatchPlacement(0.0, np.pi / 2, (0.03, 0.04)), reach)
    np.testing.assert_allclose(ordered(found), ordered(turned), atol=1e-12)
    assert np.abs(ordered(found) - ordered(plain)).max() > 0.1
    for curvature in (0.0, 1.1):
        near = shown(tile, PatchPlacement(curvature, 0.7, (0.03, 0.04)), reach)
        far = shown(tile, PatchPlacement(curvature, 0.7, (4.03, -6.96)), reach)
        np.testing.assert_allclose(ordered(far), ordered(near), atol=1e-12)


@pytest.mark.parametrize("curvature", [0.0, 0.8, -0.8])
def test_texture_coordinates_are_those_of_the_geometry(curvature: float):
    """One speck at (0.3, 0.8) of each period: wherever it is found in the world, `texture` says (0.3, 0.8)."""
    speck = np.array([0.3, 0.8, -0.05]) + 1e-4 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    tile = Tile(speck, np.array([[0, 1, 2]]), np.ones((3, 3)), 0.1, (0.0, 0.0, 0.0))
    placing = PatchPlacement(curvature, 2.2, (0.37, -1.2))
    p = shown(tile, placing, (1.5, 1.5))[:, 0, :3]
    assert len(p) in range(6, 13)
    s = p[:, 0] if curvature == 0 else np.arctan(p[:, 0] / (p[:, 2] + 1 / curvature)) / curvature
    uv = placing.texture(np.stack([s, p[:, 1]], 1))
    np.testing.assert_allclose(uv - np.floor(uv), np.broadcast_to([0.3, 0.8], uv.shape), atol=1e-9)
    assert len(np.unique(np.round(uv, 6), axis=0)) == len(uv)
    np.testing.assert_allclose(placing.texture(np.zeros(2)), placing.shift)


@pytest.mark.parametrize("curvature", [2.0, 3.0, -2.5])
def test_the_mesostructure_lies_round_a_cylinder_at_most_once(curvature: float):
    """A cylinder that is narrower than the patch is covered once, not again by what reaches round it."""
    tile = sheet(32)
    found = area(shown(tile, PatchPlacement(curvature), (2.5, 1.0)))
    np.testing.assert_allclose(found, 2 * np.pi * abs(1 / curvature - 0.05) * 2.0, rtol=0.03)


@pytest.mark.parametrize("curvature", [0.06, 1.3, -0.06, -1.3])
def test_the_body_closes_all_round(curvature: float):
    """At h = −D, each seam joined, as large as the cylinder."""
    points, faces, albedo = patch(sheet(1), PatchPlacement(curvature), (0.5, 0.5))
    points, faces = points[faces[-2 * STRIPS :]], faces[-2 * STRIPS :]
    np.testing.assert_allclose(np.hypot(points[..., 0], points[..., 2] + 1 / curvature), abs(1 / curvature - 0.1))
    assert (np.abs(points[..., 1]) == REACH).all() and (albedo[faces] == [0.1, 0.2, 0.3]).all()
    radius = abs(1 / curvature - 0.1)
    np.testing.assert_allclose(area(points), 2 * np.pi * radius * 2 * REACH, rtol=1e-5)
    places, same = np.unique(np.round(points.reshape(-1, 3), 6) + 0.0, axis=0, return_inverse=True)
    corner = same.reshape(-1, 3)
    edges = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
    edges, uses = np.unique(edges, axis=0, return_counts=True)
    rim = places[edges[:, 0], 1] == places[edges[:, 1], 1]
    assert rim.sum() == 2 * STRIPS and (uses[rim] == 1).all() and (uses[~rim] == 2).all()


@pytest.mark.parametrize("curvature", [0.0, 0.01, -0.01])
def test_a_body_that_does_not_close_reaches_far(curvature: float):
    points, faces, _ = patch(sheet(1), PatchPlacement(curvature), (0.5, 0.5))
    body = points[faces[-2 * STRIPS :]]
    np.testing.assert_allclose(area(body), (2 * REACH) ** 2 * (1 - 0.1 * curvature), rtol=1e-5)
    if curvature == 0:
        assert (body[..., 2] == -0.1).all() and np.abs(body[..., 0]).max() == REACH


@pytest.mark.parametrize("curvature", [0.0, 1.2, -0.7])
def test_every_vertex_is_used_and_none_is_missing(curvature: float):
    points, faces, albedo = patch(sheet(4), PatchPlacement(curvature, 0.4, (0.2, 0.1)), (1.2, 0.7))
    np.testing.assert_array_equal(np.unique(faces), np.arange(len(points)))
    assert albedo.shape == points.shape and np.isfinite(points).all()
