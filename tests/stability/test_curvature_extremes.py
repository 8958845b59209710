"""Hard case 17: curvature near flat, at borders, saddles, valence 3, vertices where surfaces touch; far, tiny and huge meshes.

Notation
h       edge length
δ       rounding of a float32 coordinate; a curvature is told to about δ / h²
"""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from mesoshell.geometry.curvature import curvature_table, range_of
from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.geometry.principal_curvature import along, principal
from mesoshell.geometry.topology import pair_edges
from tests.helpers.stability.surfaces import ball, plain, sheet, together, unit

ICO = trimesh.creation.icosphere(3)


def border(mesh: Mesh) -> np.ndarray:
    f, k = np.nonzero(~pair_edges(mesh.faces).opposed)
    on = np.zeros(len(mesh.vertices), bool)
    on[mesh.faces[f, k]] = on[mesh.faces[f, (k + 1) % 3]] = True
    return on


def saddle_values(x: np.ndarray) -> np.ndarray:
    """Of z = (x² − y²) / 2, grown upward."""
    w = np.sqrt(1 + x[:, 0] ** 2 + x[:, 1] ** 2)
    mean = (x[:, 0] ** 2 - x[:, 1] ** 2) / (2 * w**3)
    half = np.sqrt(mean**2 + 1 / w**4)
    return np.stack([mean + half, mean - half], axis=1)


def saddle(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x * x - y * y) / 2


@pytest.mark.parametrize("k", [1e-2, 1e-4, 1e-6, 1e-10, 0.0])
def test_nearly_flat_and_flat(k: float):
    mesh = sheet(lambda x, y: k * saddle(x, y), 17)
    found = principal(mesh)
    assert found.mended == 0
    np.testing.assert_allclose(found.values, np.tile([k, -k], (len(mesh.vertices), 1)), rtol=2e-4, atol=1e-30)
    turned = plain(mesh.vertices @ Rotation.random(rng=np.random.default_rng(1)).as_matrix().T, mesh.faces)
    found = principal(turned)  # δ is 6e-8 here and h 0.125
    assert found.mended == 0
    np.testing.assert_allclose(found.values, np.tile([k, -k], (len(mesh.vertices), 1)), atol=1e-5)
    assert np.isfinite(curvature_table(turned, 0.5, directions=4).kappa).all()


def test_the_faces_of_a_box_are_flat_and_none_is_mended():
    box = trimesh.creation.box().subdivide().subdivide().subdivide()
    mesh = plain(np.array(box.vertices), np.array(box.faces))
    found = principal(mesh)
    away = (np.abs(mesh.vertices) < 0.5 - 2.5 / 8).sum(axis=1) == 2
    assert found.mended == 0 and away.sum() == 54
    assert (found.values[away] == 0).all() and (found.values >= -1e-9).all() and found.values.max() > 4


def test_far_from_the_origin_it_is_as_exact_as_the_coordinates():
    snapped = np.round(8 * ICO.vertices * 64) / 64  # which float32 holds at 1e5 too
    near, far = (principal(plain(snapped + away, np.array(ICO.faces))) for away in (0.0, 1e5))
    np.testing.assert_allclose(far.values, near.values, atol=1e-9)
    for radius, h in ((10.0, 1.4), (100.0, 14.0)):
        near, far = (principal(plain(radius * ICO.vertices + away, np.array(ICO.faces))) for away in (0.0, 1e5))
        assert far.mended == 0
        assert np.abs(far.values - near.values).max() < 0.004 / h**2  # δ is 0.004


@pytest.mark.parametrize("size", [1e-37, 1e-30, 1e-3, 1e11])
def test_tiny_and_huge_meshes(size: float):
    table = curvature_table(plain(size * ICO.vertices, np.array(ICO.faces)), size, directions=4)
    np.testing.assert_allclose(table.kappa.astype(np.float64) * size, 1, atol=0.03)
    assert table.mended == 0


def test_what_float32_cannot_hold_is_the_most_that_it_can():
    table = curvature_table(plain(1e-38 * ICO.vertices / 8, np.array(ICO.faces)), 0.0, directions=4)
    assert range_of(table) == (np.finfo(np.float32).max,) * 2


def test_at_the_border_of_a_saddle_the_error_is_of_first_order():
    worst = []
    for side in (9, 17, 33):
        mesh = sheet(saddle, side)
        found = principal(mesh)
        error = np.abs(found.values - saddle_values(mesh.vertices.astype(np.float64))).max(axis=1)
        worst.append(error[border(mesh)].max())
        assert found.mended == 0
    assert worst[0] < 0.2 and worst[1] < worst[0] / 1.8 and worst[2] < worst[1] / 1.8


def test_slivers_at_a_border_are_mended():
    """Random points, whose hull's triangles stand at any angle: a fit there is off by up to 20."""
    xy = np.random.default_rng(0).uniform(-1, 1, (1089, 2))
    mesh = plain(np.column_stack([xy, saddle(*xy.T)]), Delaunay(xy).simplices)
    found = principal(mesh)
    error = np.abs(found.values - saddle_values(mesh.vertices.astype(np.float64))).max(axis=1)
    assert 20 < found.mended < 60 and found.notes == (
        f"curvature of {found.mended} vertices taken from the neighbours",
    )
    assert error.max() < 1.2 and np.sqrt((error**2).mean()) < 0.06
    assert np.isfinite(curvature_table(mesh, 0.3, directions=4).kappa).all()


def test_a_monkey_saddle_is_flat_in_its_middle():
    mesh = sheet(lambda x, y: x**3 - 3 * x * y * y, 41)
    middle = np.linalg.norm(mesh.vertices, axis=1).argmin()
    table = curvature_table(mesh, 0.4, directions=4)
    assert np.abs(principal(mesh).values[middle]).max() < 0.02
    # 6 r along the valleys, at r = 0.2, slope 0.12: −6 r / (1 + slope²)^1.5 is the least that any direction meets
    assert -1.25 < table.kappa[middle].min() < -1.0


def test_valence_three():
    """Each triangle of a ball divided into three by a point on the sphere."""
    centre = unit(ICO.triangles_center)
    f, i = ICO.faces, len(ICO.vertices) + np.arange(len(ICO.faces))
    faces = np.concatenate([np.stack([f[:, k], f[:, (k + 1) % 3], i], axis=1) for k in range(3)])
    found = principal(plain(np.concatenate([ICO.vertices, centre]), faces))
    assert found.mended == 0
    np.testing.assert_allclose(found.values, 1, atol=0.025)


TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.mark.parametrize("faces", [[[0, 1, 2]], [[0, 1, 2], [2, 1, 3]], TETRAHEDRON])
def test_too_small_to_be_curved(faces: np.ndarray):
    points = np.random.default_rng(0).normal(size=(4, 3))[: np.max(faces) + 1]
    table = curvature_table(plain(points, np.array(faces)), 1.0, directions=4)
    assert table.notes == (f"{len(points)} vertices taken as flat: no neighbour has a usable curvature",)
    assert (table.kappa == 0).all() and table.mended == len(points)


def test_a_small_part_beside_a_large_one():
    small = plain(5 + np.eye(4)[:, :3], TETRAHEDRON)
    alone, both = principal(ball(2)), principal(together(ball(2), small))
    np.testing.assert_allclose(both.values[:162], alone.values, rtol=1e-9)
    assert (both.values[162:] == 0).all() and both.mended == 4


def test_balls_that_touch_at_a_vertex():
    one = ball(2)
    top = one.vertices[:, 2].argmax()
    points = np.concatenate([one.vertices, one.vertices * [1, 1, -1] + [0, 0, 2 * one.vertices[top, 2]]])
    faces = np.concatenate([one.faces, one.faces[:, ::-1] + len(one.vertices)])
    mesh = plain(points, faces)
    found, alone = principal(mesh), principal(one)
    assert len(mesh.vertices) == 2 * len(one.vertices) - 1
    assert found.mended == 1 and found.notes == ("curvature of 1 vertex taken from the neighbours",)
    others = np.arange(len(one.vertices)) != top
    np.testing.assert_allclose(found.values[:162][others], alone.values[others], rtol=1e-6)
    np.testing.assert_allclose(found.values[top], 1.07, atol=0.03)


def test_a_mended_vertex_has_its_neighbours_tensor():
    """A trough turned over, with a needle standing on its middle."""
    trough = sheet(lambda x, y: -x * x / 2, 33)
    middle, count = np.linalg.norm(trough.vertices, axis=1).argmin(), len(trough.vertices)
    turn = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    points = np.concatenate([trough.vertices, [[0.01, 0, 0.5], [-0.01, 0, 0.5]]]) @ turn.T
    mesh = plain(points, np.concatenate([trough.faces, [[middle, count, count + 1]]]))
    found = principal(mesh)
    assert found.mended == 3
    np.testing.assert_allclose(found.values[middle], [1, 0], atol=0.01)
    np.testing.assert_allclose(np.abs(found.directions[middle, 0] @ turn[:, 0]), 1, atol=1e-3)


def test_three_sheets_on_one_edge():
    half = sheet(lambda x, y: 0 * x, 9)
    x, y, _ = half.vertices.T
    leaves = [np.stack([(x + 1) * np.cos(a), y, (x + 1) * np.sin(a)], axis=1) for a in (0, 2.1, 4.2)]
    points = np.round(np.concatenate(leaves), 6)
    mesh = plain(points, np.concatenate([half.faces + i * len(x) for i in range(3)]))
    table = curvature_table(mesh, 0.5, directions=8)
    assert table.mended == 9 and any("more than two faces" in note for note in mesh.notes)
    np.testing.assert_allclose(table.kappa, 0, atol=5e-5)


def test_a_moebius_band():
    a, s = np.meshgrid(np.linspace(0, 2 * np.pi, 41)[:-1], np.linspace(-0.3, 0.3, 7), indexing="ij")
    points = np.stack(
        [(1 + s * np.cos(a / 2)) * np.cos(a), (1 + s * np.cos(a / 2)) * np.sin(a), s * np.sin(a / 2)], axis=-1
    )
    i = np.arange(280).reshape(40, 7)
    i = np.concatenate([i, i[:1, ::-1]])
    p, q, r, t = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    mesh = plain(points.reshape(-1, 3), np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, t], 1)]))
    table = curvature_table(mesh, 20.0, directions=8)
    assert any("one-sided" in note for note in mesh.notes)
    assert np.isfinite(table.kappa).all() and np.abs(range_of(table)).max() < 5


def test_curves_through_vertices_along_edges_and_along_a_border():
    """A trough on a grid: directions of the grid and of its diagonals meet nothing but vertices and edges."""
    mesh = sheet(lambda x, y: np.maximum(x, 0) ** 2, 33)
    found = principal(mesh)
    middle = np.linalg.norm(mesh.vertices - [-0.25, 0, 0], axis=1).argmin()
    row = np.abs(mesh.vertices[:, 1]) < 1e-6
    across = along(found.values[row], found.directions[row], np.tile([1.0, 0, 0], (row.sum(), 1)))
    for length, expected in ((0.2, 0.0), (1.5, across.min()), (9.0, across.min())):
        np.testing.assert_allclose(curvature_table(mesh, length, directions=8).kappa[middle].min(), expected, atol=1e-3)
    flat = plain(mesh.vertices * [1, 1, 0], mesh.faces)
    np.testing.assert_allclose(curvature_table(flat, 3.0, directions=8).kappa, 0, atol=1e-6)


@settings(max_examples=30)
@given(st.integers(4, 40), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_triangles_thrown_together_have_finite_curvature(count: int, many: int, seed: int):
    rng = np.random.default_rng(seed)
    points = np.round(rng.normal(size=(count, 3)), rng.integers(0, 6))
    corners = np.array([rng.choice(count, 3, replace=False) for _ in range(many)])
    p = points[corners]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    if not (area > 1e-6).any():
        return
    mesh = check_mesh(points, corners, np.tile([[0.0, 0], [1, 0], [0, 1]], (many, 1, 1)), "mesh")
    table = curvature_table(mesh, rng.choice([0.0, 0.1, 1.0, 1e6]), directions=5)
    found = principal(mesh)
    assert np.isfinite(table.kappa).all() and np.isfinite(found.values).all()
    n = np.cross(found.directions[:, 0], found.directions[:, 1])
    np.testing.assert_allclose(n, mesh.normals, atol=1e-5)
    assert (found.values[:, 0] >= found.values[:, 1]).all()
