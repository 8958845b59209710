"""Hard case 5: a degenerate or sliver triangle is dropped with its index, or exact to 1e-6 (oracle: mpmath)."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.mesh import check_mesh
from mesoshell.geometry.normals import face_normals
from mesoshell.shell.geometry.extrude import extrude

UV = np.array([[0.0, 0], [1, 0], [0, 1]])
WHOLE = np.array([[0.0, 0, 5], [1, 0, 5], [0, 1, 5]])


def exact_normal(triangle: np.ndarray) -> np.ndarray:
    with mpmath.workdps(60):
        a, b, c = ([mpmath.mpf(float(x)) for x in corner] for corner in triangle)
        p, q = ([y - x for x, y in zip(a, end, strict=True)] for end in (b, c))
        n = [p[i - 2] * q[i - 1] - p[i - 1] * q[i - 2] for i in range(3)]
        length = mpmath.sqrt(sum(x * x for x in n))
        return np.array([float(x / length) for x in n])


def relative_height(triangle: np.ndarray) -> float:
    with mpmath.workdps(60):
        a, b, c = (mpmath.matrix([float(x) for x in corner]) for corner in triangle)
        sides = [b - a, c - b, a - c]
        longest = max(float(mpmath.fdot(s, s).real) for s in sides)
        p, q = sides[0], -sides[2]
        squared = mpmath.fdot(p, p) * mpmath.fdot(q, q) - mpmath.fdot(p, q) ** 2
        return float(mpmath.sqrt(abs(squared)) / longest)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(-14, -1), st.sampled_from([0.0, 1.0, 1e3, 1e5]))
def test_a_sliver_is_dropped_by_its_index_or_exact(seed: int, exponent: int, away: float):
    rng = np.random.default_rng(seed)
    a, b, w = rng.normal(size=(3, 3))
    c = a + rng.uniform(0.1, 0.9) * (b - a) + 10.0**exponent * w
    sliver = (np.stack([a, b, c]) + away).astype(np.float32)
    mesh = check_mesh(np.concatenate([WHOLE, sliver]), np.arange(6).reshape(2, 3), np.stack([UV, UV]), "mesh")
    if len(mesh.faces) == 1:
        assert relative_height(sliver) <= 1.001e-9
        assert mesh.notes == ("1 zero-area face dropped (first: index 1)",)
        assert len(mesh.vertices) == 3
    else:
        assert relative_height(sliver) >= 0.999e-9
        assert mesh.notes == ()
        exact = exact_normal(sliver)
        np.testing.assert_allclose(mesh.normals[mesh.faces[1]], [exact] * 3, atol=1e-6)
        np.testing.assert_allclose(face_normals(mesh.vertices.astype(np.float64), mesh.faces)[1], exact, atol=1e-6)
        shell = extrude(mesh, 0.5, 1.0)
        np.testing.assert_allclose(shell.offset[shell.faces[1]], [0.5 * exact] * 3, atol=1e-6)


@pytest.mark.parametrize(
    ("triangle", "kept"),
    [
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [1, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [3, 0, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [0.5, 5e-10, 0]], False),
        ([[0, 0, 0], [1, 0, 0], [0.5, 2e-9, 0]], True),
        ([[0, 0, 0], [1e-30, 0, 0], [0, 1e-30, 0]], True),
        ([[0, 0, 0], [1e-38, 0, 0], [0, 1e-38, 0]], True),
        ([[0, 0, 0], [1e11, 0, 0], [0, 1e11, 0]], True),
    ],
)
def test_the_bound_is_on_shape_and_not_on_size(triangle: list[list[float]], kept: bool):
    mesh = check_mesh(np.concatenate([triangle, WHOLE]), np.arange(6).reshape(2, 3), np.stack([UV, UV]), "mesh")
    assert mesh.notes == (() if kept else ("1 zero-area face dropped (first: index 0)",))
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * len(mesh.vertices))


def test_dropping_a_collapsed_face_leaves_no_border():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 1, 0]])
    faces = np.array([[0, 1, 2], [2, 4, 0], [0, 4, 3]])
    shell = extrude(check_mesh(points, faces, np.stack([UV] * 3), "mesh"), 0.5, 1.0)
    assert shell.neighbour.tolist() == [[-1, -1, 1], [0, -1, -1]]
    assert shell.mesh_face.tolist() == [0, 1]
