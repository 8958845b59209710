"""Curvature: against closed forms, at several resolutions; along curves; and its laws.

Notation
F       a function that is 0 on a surface and grows outward
S       P H P / |∇F|, H the Hessian of F and P the projection to the tangent plane: κ(d) = d·S d for a unit tangent d
"""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mesoshell.errors import InputError
from mesoshell.geometry import curvature
from mesoshell.geometry.curvature import CurvatureTable, curvature_table, lookup, range_of
from mesoshell.geometry.mesh import Mesh, check_mesh, load_mesh
from mesoshell.geometry.principal_curvature import along, principal

DATA = Path(__file__).parents[1] / "data"
RADII = np.array([1.5, 1.0, 0.7])
Y, Z = np.array([0.0, 1, 0]), np.array([0.0, 0, 1])


def plain(points: np.ndarray, faces: np.ndarray) -> Mesh:
    return check_mesh(points, faces, np.tile([[0.0, 0], [1, 0], [0, 1]], (len(faces), 1, 1)), "mesh")


def grid(points: np.ndarray) -> Mesh:
    """A sheet through rows and columns of points, whose outer side has rows to the right and columns ahead."""
    i = np.arange(points[..., 0].size).reshape(points.shape[:2])
    a, b, c, d = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return plain(points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def ball(n: int) -> Mesh:
    made = trimesh.creation.icosphere(1 + n)
    return plain(2 * np.array(made.vertices), np.array(made.faces))


def ellipsoid(n: int) -> Mesh:
    made = trimesh.creation.icosphere(1 + n)
    return plain(RADII * made.vertices, np.array(made.faces))


def torus(n: int) -> Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=20 * 2**n, minor_sections=10 * 2**n)
    return plain(np.array(made.vertices), np.array(made.faces))


def tube(n: int) -> Mesh:
    """A cylinder of radius 0.5 along z, open at both ends."""
    sections, rows = 16 * 2**n, 5 * 2**n
    angle = np.arange(sections + 1) % sections * (2 * np.pi / sections)  # welded where it closes
    a, z = np.meshgrid(angle, np.linspace(-1, 1, rows + 1), indexing="ij")
    return grid(np.stack([0.5 * np.cos(a), 0.5 * np.sin(a), z], axis=-1))


def saddle(n: int) -> Mesh:
    x, y = np.meshgrid(*[np.linspace(-1, 1, 8 * 2**n + 1)] * 2, indexing="ij")
    return grid(np.stack([x, y, (x * x - y * y) / 2], axis=-1))


def torus_hessian(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    out = unit(x * [1, 1, 0])
    distance = np.hypot(x[:, 0], x[:, 1])
    gradient = (distance - 1)[:, None] * out + x * [0, 0, 1]
    radial = np.einsum("vi,vj->vij", out, out)
    hessian = radial + (1 - 1 / distance)[:, None, None] * (np.diag([1, 1, 0]) - radial) + np.diag([0, 0, 1])
    return gradient, hessian


def from_mean(mean: np.ndarray, gauss: np.ndarray) -> np.ndarray:
    half = np.sqrt(np.maximum(mean * mean - gauss, 0))
    return np.stack([mean + half, mean - half], axis=1)


def ellipsoid_values(x: np.ndarray) -> np.ndarray:
    h = 1 / np.sqrt((x**2 / RADII**4).sum(axis=1))
    mean = h**3 * ((RADII**2).sum() - (x**2).sum(axis=1)) / (2 * np.prod(RADII) ** 2)
    return from_mean(mean, h**4 / np.prod(RADII) ** 2)


def saddle_values(x: np.ndarray) -> np.ndarray:
    w = np.sqrt(1 + x[:, 0] ** 2 + x[:, 1] ** 2)
    return from_mean((x[:, 0] ** 2 - x[:, 1] ** 2) / (2 * w**3), -1 / w**4)


def torus_values(x: np.ndarray) -> np.ndarray:
    distance = np.hypot(x[:, 0], x[:, 1])
    return np.stack([np.full(len(x), 2.5), (distance - 1) / (0.4 * distance)], axis=1)


class Surface(NamedTuple):
    """How to mesh it, its principal values, ∇F and H; what its error is at most, and where a border is far."""

    mesh: Callable[[int], Mesh]
    values: Callable[[np.ndarray], np.ndarray]
    derivatives: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    error: float  # at n = 3, in 1 / world length
    inner: tuple[float, float, float] = (9, 9, 9)


def quadric(*diagonal: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    return lambda x: (x * diagonal, np.broadcast_to(np.diag(diagonal), (len(x), 3, 3)))


SURFACES = {
    "sphere": Surface(ball, lambda x: np.full((len(x), 2), 0.5), quadric(1, 1, 1), 0.004),
    "cylinder": Surface(tube, lambda x: np.tile([2.0, 0.0], (len(x), 1)), quadric(1, 1, 0), 0.006, (9, 9, 0.5)),
    "torus": Surface(torus, torus_values, torus_hessian, 0.02),
    "saddle": Surface(
        saddle, saddle_values, lambda x: (x * [-1, 1, 0] + [0, 0, 1], np.tile(np.diag([-1, 1, 0]), (len(x), 1, 1))),
        0.0006, (0.6, 0.6, 9),
    ),
    "ellipsoid": Surface(ellipsoid, ellipsoid_values, quadric(*RADII**-2), 0.05),
}  # fmt: skip
every_surface = pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)


def tensor(surface: Surface, x: np.ndarray) -> np.ndarray:
    gradient, hessian = surface.derivatives(x)
    n = unit(gradient)
    plane = np.eye(3) - np.einsum("vi,vj->vij", n, n)
    return plane @ hessian @ plane / np.linalg.norm(gradient, axis=1)[:, None, None]


def errors(surface: Surface, n: int) -> tuple[float, float, float]:
    """The greatest errors of values, of directions (as curvature: sin 2θ for half the difference), and along any."""
    mesh = surface.mesh(n)
    x = mesh.vertices.astype(np.float64)
    inner = (np.abs(x) < surface.inner).all(axis=1)
    found, exact, s = principal(mesh), surface.values(x), tensor(surface, x)
    assert found.mended == 0 and found.notes == ()
    off = np.einsum("vi,vij,vj->v", found.directions[:, 0], s, found.directions[:, 1])
    normal = unit(surface.derivatives(x)[0])
    d = unit(np.cross(np.random.default_rng(n).normal(size=x.shape), normal))
    kappa = along(found.values, found.directions, d) - np.einsum("vi,vij,vj->v", d, s, d)
    return tuple(np.abs(e[inner]).max() for e in (found.values - exact, off, kappa))


@every_surface
def test_errors_are_small_and_shrink_with_the_edges(surface: Surface):
    coarse, middle, fine = (np.array(errors(surface, n)) for n in (1, 2, 3))
    assert (fine < surface.error).all()
    assert (middle < coarse / 2 + 1e-4).all() and (fine < coarse / 4 + 1e-4).all()


@every_surface
def test_directions_are_a_frame_on_the_normal(surface: Surface):
    mesh = surface.mesh(1)
    d1, d2 = np.moveaxis(principal(mesh).directions, 1, 0)
    np.testing.assert_allclose(np.cross(d1, d2), mesh.normals, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm([d1, d2], axis=-1), 1, atol=1e-12)


@settings(max_examples=20)
@given(st.floats(-10, 10), st.floats(-10, 10), st.integers(0, 2**32 - 1))
def test_along_a_direction_and_along_the_normal(k1: float, k2: float, seed: int):
    frame = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    values, directions = np.array([[k1, k2]]), frame[None, :2]
    angle, slope = np.random.default_rng(seed).uniform(-np.pi, np.pi, 2)
    d = [np.cos(angle), np.sin(angle), 3 * slope] @ frame
    expected = k1 * np.cos(angle) ** 2 + k2 * np.sin(angle) ** 2
    np.testing.assert_allclose(along(values, directions, 7 * d[None]), [expected], atol=1e-12)
    np.testing.assert_allclose(along(values, directions, frame[None, 2]), [(k1 + k2) / 2], atol=1e-12)
    np.testing.assert_allclose(along(values, directions, np.zeros((1, 3))), [(k1 + k2) / 2], atol=1e-12)


def at(table: CurvatureTable, vertices: np.ndarray, d: np.ndarray) -> np.ndarray:
    """What a lookup at vertices gives."""
    faces = np.stack(np.broadcast_arrays(vertices, 0, 0), axis=1)
    return lookup(table, faces, np.broadcast_to([1.0, 0, 0], faces.shape), np.broadcast_to(d, faces.shape))


def nearest(mesh: Mesh, *points: tuple[float, float, float]) -> np.ndarray:
    return np.array([np.linalg.norm(mesh.vertices - p, axis=1).argmin() for p in points])


def test_along_the_equators_of_a_torus():
    mesh = torus(2)
    outer, inner = np.split(nearest(mesh, (1.4, 0, 0), (0.6, 0, 0)), 2)
    for length in (0.0, 0.5, 30.0):  # as if round it more than three times
        table = curvature_table(mesh, length, directions=4)
        np.testing.assert_allclose(at(table, outer, Y), 1 / 1.4, rtol=0.02)
        np.testing.assert_allclose(at(table, inner, Y), -1 / 0.6, rtol=0.02)
        np.testing.assert_allclose(at(table, np.append(outer, inner), Z), 2.5, rtol=0.03)


def test_across_and_along_a_cylinder():
    mesh = tube(2)
    middle = np.flatnonzero(np.abs(mesh.vertices[:, 2]) < 0.3)
    around = np.cross([0, 0, 1.0], mesh.vertices[middle])
    for length in (0.0, 0.4, 10.0):
        table = curvature_table(mesh, length, directions=4)
        np.testing.assert_allclose(at(table, middle, around), 2, rtol=0.01)
        np.testing.assert_allclose(at(table, middle, Z), 0, atol=0.1)


def test_least_curvature_on_an_arc_of_an_ellipse():
    mesh = ellipsoid(3)
    a, b = RADII[:2]
    t = np.linspace(0, np.pi / 2, 4001)
    speed = np.hypot(a * np.sin(t), b * np.cos(t))
    arc = np.append(0, np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t)))
    pole = nearest(mesh, (a, 0, 0))
    for half in (0.0, 0.2, 0.7, 1.5):
        table = curvature_table(mesh, 2 * half, directions=4)
        expected = a * b / np.interp(half, arc, speed) ** 3  # it falls from a / b² to b / a² on the way to t = π / 2
        np.testing.assert_allclose(at(table, pole, Y), expected, rtol=0.03)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_sheet_that_bends_to_a_quarter_cylinder(sense: int):
    r, h = 0.5, 0.04
    s = np.arange(-25, 21) * h
    a = np.maximum(s, 0) / r
    x, z = np.minimum(s, 0) + r * np.sin(a), -sense * r * (1 - np.cos(a))
    y = np.arange(-6, 7) * h
    mesh = grid(np.stack(np.broadcast_arrays(x[:, None], y, z[:, None]), axis=-1))
    line = np.arange(len(s)) * len(y) + 6
    d = np.stack([np.cos(a), 0 * a, -sense * np.sin(a)], axis=1)
    for length in (0.0, 0.4, 0.8):
        kappa = at(curvature_table(mesh, length, directions=8), line, d)
        lowest = s + length / 2 if sense < 0 else s - length / 2  # where its curve sees least, if not at a border
        sure = np.abs(lowest) > 2.5 * h
        expected = np.where(lowest > 0, sense / r, 0)
        np.testing.assert_allclose(kappa[sure], expected[sure], atol=0.03 / r)
        assert sure.sum() > 35 and len(np.unique(expected[sure])) == 2


def test_a_capsule_is_as_flat_as_the_cylinder_that_its_curve_reaches():
    made = trimesh.creation.capsule(height=2.0, radius=0.5, count=[48, 48])
    mesh = plain(made.vertices - np.mean(made.bounds, axis=0), np.array(made.faces))
    angles = np.array([1.2, 0.5])  # from the pole: 0.18 and 0.53 of arc above the cylinder
    points = nearest(mesh, *((0.5 * np.sin(a), 0, 1 + 0.5 * np.cos(a)) for a in angles))
    south = np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], axis=1)
    table = curvature_table(mesh, 0.6, directions=16)
    np.testing.assert_allclose(at(table, points, south), [0, 2], atol=0.06)
    np.testing.assert_allclose(at(table, points, Y), 2, atol=0.06)


def whole_sections(mesh: Mesh, vertex: int, d: np.ndarray) -> float:
    """The least curvature on all of a plane's section, triangle by triangle (trimesh cuts them)."""
    found = principal(mesh)
    solid = trimesh.Trimesh(mesh.vertices.astype(np.float64), mesh.faces, process=False)
    m = unit(np.cross(np.cross(*found.directions[vertex]), d))
    lines, faces = trimesh.intersections.mesh_plane(solid, m, solid.vertices[vertex], return_faces=True)
    bary = [trimesh.triangles.points_to_barycentric(solid.triangles[faces], lines[:, end]) for end in (0, 1)]
    corner = mesh.faces[faces]
    d = np.cross(m, solid.face_normals[faces])[:, None]
    kappa = along(found.values[corner], found.directions[corner], d)
    return min((b * kappa).sum(axis=1).min() for b in bary)


def test_a_long_curve_sees_all_that_its_plane_cuts():
    rng = np.random.default_rng(0)
    made = trimesh.creation.icosphere(2)
    mesh = plain(made.vertices * rng.uniform(0.97, 1.03, (162, 1)), np.array(made.faces))
    found, table = principal(mesh), curvature_table(mesh, 100.0, directions=4)
    for vertex in rng.choice(162, 20, replace=False):
        for j in range(4):
            d = [np.cos(j * np.pi / 4), np.sin(j * np.pi / 4)] @ found.directions[vertex]
            np.testing.assert_allclose(table.kappa[vertex, j], whole_sections(mesh, vertex, d), atol=1e-4)


def test_a_closed_curve_is_walked_once(monkeypatch: pytest.MonkeyPatch):
    steps, step, mesh = [], curvature._step, ball(1)
    monkeypatch.setattr(curvature, "_step", lambda *given: steps.append(0) or step(*given))
    curvature_table(mesh, 1e9, directions=1)
    assert len(steps) < len(mesh.faces) / 4


def test_a_longer_curve_never_sees_more_and_a_point_is_euler():
    mesh = load_mesh(DATA / "spot.obj")
    found = principal(mesh)
    tables = [curvature_table(mesh, length, directions=4) for length in (0.0, 0.05, 0.2)]
    d = (found.directions[:, 0] + found.directions[:, 1]) / np.sqrt(2)
    np.testing.assert_allclose(tables[0].kappa[:, 1], along(found.values, found.directions, d), rtol=1e-5, atol=1e-5)
    for short, long in pairwise(tables):
        assert (long.kappa <= short.kappa).all() and (long.kappa < short.kappa).any()


def test_lookup_interpolates_between_directions_and_corners():
    t, b = np.eye(3, dtype=np.float32)[[0, 1]]
    kappa = np.array([[0, 1, 2, 5], [10, 10, 10, 10], [0, 0, 0, 8]], np.float32)
    table = CurvatureTable(kappa, np.tile(t, (3, 1)), np.tile(b, (3, 1)), 0, ())
    angles = np.radians([0, 45, 67.5, 135, 157.5, 180, -45, 225])
    d = np.stack([np.cos(angles), np.sin(angles), 0.7 + 0 * angles], axis=1)
    faces, first, second = (np.tile(x, (8, 1)) for x in ([0, 1, 2], [1.0, 0, 0], [0.0, 1, 0]))
    np.testing.assert_allclose(lookup(table, faces, first, 3 * d), [0, 1, 1.5, 5, 2.5, 0, 5, 1], atol=1e-5)
    np.testing.assert_allclose(lookup(table, faces, second, d), 10)
    mixed = np.tile([0.5, 0.25, 0.25], (8, 1))
    np.testing.assert_allclose(lookup(table, faces, mixed, d)[:4], [2.5, 3, 3.25, 7], atol=1e-5)
    assert np.isfinite(lookup(table, faces, first, np.tile(Z, (8, 1)))).all()
    assert range_of(table) == (0.0, 10.0)


def test_between_directions_a_point_is_right_to_a_quarter_percent_of_the_difference():
    mesh = torus(1)
    table, found = curvature_table(mesh, 0.0), principal(mesh)
    d = np.random.default_rng(1).normal(size=mesh.vertices.shape)
    i = np.arange(len(d))
    error = at(table, i, d) - along(found.values, found.directions, d)
    assert (np.abs(error) < (np.pi / 32) ** 2 / 4 * np.ptp(found.values, axis=1) + 1e-5).all()
    np.testing.assert_allclose(at(table, i, -d), at(table, i, d), atol=1e-5)


@pytest.mark.parametrize("length", [-1.0, np.nan, np.inf])
def test_a_length_must_be_a_length(length: float):
    with pytest.raises(InputError, match="must be finite and not negative"):
        curvature_table(ball(1), length)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.integers(-6, 6), st.sampled_from([0.0, 0.3]))
def test_turned_and_scaled_meshes_have_the_same_curvature_in_their_units(seed: int, exponent: int, length: float):
    mesh, scale = torus(0), 10.0**exponent
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    moved = plain(scale * mesh.vertices @ turn.T, mesh.faces)
    d = np.random.default_rng(seed).normal(size=mesh.vertices.shape)
    i = np.arange(len(d))
    before = at(curvature_table(mesh, length), i, d)
    after = at(curvature_table(moved, scale * length), i, d @ turn.T)
    np.testing.assert_allclose(scale * after, before, atol=2e-3)


def test_a_ball_is_convex_however_it_was_wound():
    mesh = ball(1)
    turned = plain(mesh.vertices, mesh.faces[:, ::-1])
    assert turned.notes == ("the whole mesh was inside out: flipped",)
    assert (principal(turned).values > 0.4).all()
    flipped = mesh.faces.copy()
    flipped[::7] = flipped[::7, ::-1]
    np.testing.assert_allclose(principal(plain(mesh.vertices, flipped)).values, principal(mesh).values, atol=1e-9)
    hollow = plain(
        np.concatenate([mesh.vertices, 2 * mesh.vertices]),
        np.concatenate([mesh.faces[:, ::-1], mesh.faces + len(mesh.vertices)]),
    )
    assert (principal(hollow).values[: len(mesh.vertices)] < -0.4).all()


@pytest.mark.parametrize(("name", "mended"), [("spot", 0), ("suzanne", 17), ("cross", 8)])
def test_meshes_as_they_are(name: str, mended: int):
    mesh = load_mesh(DATA / f"{name}.obj")
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    table = curvature_table(mesh, 0.05 * diagonal, directions=8)
    assert table.mended == mended and bool(table.notes) == (mended > 0)
    assert np.isfinite(table.kappa).all() and table.kappa.dtype == np.float32
    assert np.abs(range_of(table)).max() < 1000 / diagonal
