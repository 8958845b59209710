"""Convexity, against every vertex before every face."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mesoshell.geometry.convex import TOLERANCE, TRIED, is_convex
from mesoshell.geometry.mesh import Mesh, check_mesh


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return check_mesh(vertices, faces, np.random.default_rng(0).random((len(faces), 3, 2)), "made here")


def by_hand(mesh: Mesh) -> bool:
    v = mesh.vertices.astype(np.float64)
    p = v[mesh.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    before = (v @ n.T - np.einsum("fi,fi->f", p[:, 0], n)) / np.linalg.norm(n, axis=1)
    return before.max() <= TOLERANCE * np.ptp(v, axis=0).max()


def ball(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rings of longitude and latitude, closed at the poles."""
    theta, phi = np.pi * np.arange(1, n) / n, 2 * np.pi * np.arange(2 * n) / (2 * n)
    ring = np.stack([np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi))], axis=-1)
    z = np.broadcast_to(np.cos(theta)[:, None, None], (n - 1, 2 * n, 1))
    v = np.concatenate([np.concatenate([ring, z], axis=-1).reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    i, j = np.meshgrid(np.arange(n - 2), np.arange(2 * n), indexing="ij")
    a, b = (i * 2 * n + j).ravel(), (i * 2 * n + (j + 1) % (2 * n)).ravel()
    k, top, last = np.arange(2 * n), len(v) - 2, (n - 2) * 2 * n
    caps = [
        np.stack([k * 0 + top, k, (k + 1) % (2 * n)], 1),
        np.stack([k * 0 + top + 1, last + (k + 1) % (2 * n), last + k], 1),
    ]
    return v, np.concatenate([np.stack([a, a + 2 * n, b], 1), np.stack([b, a + 2 * n, b + 2 * n], 1), *caps])


def sheet(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of n × n quads."""
    y, x = np.divmod(np.arange((n + 1) ** 2), n + 1)
    i, j = np.divmod(np.arange(n * n), n)
    a = i * (n + 1) + j
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a + 1, a + n + 2, a + n + 1], 1)])
    return np.stack([x / n, y / n, 0 * x], 1), faces


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["ball", "sheet", "roof", "bowl", "box"]),
    st.integers(3, 9),
    st.sampled_from([0.0, 3e-7, 3e-6, 1e-3]),
    st.integers(0, 2**32 - 1),
    st.integers(-4, 4),
)
def test_it_is_as_by_hand(kind: str, n: int, dent: float, seed: int, exponent: int):
    """However a mesh lies, whatever its size, and wherever it has a dent."""
    random = np.random.default_rng(seed)
    v, faces = ball(n) if kind in ("ball", "box") else sheet(n)
    v = np.array(v)
    if kind == "box":
        v = np.clip(3 * v, -1, 1)
    if kind in ("roof", "bowl"):
        v[:, 2] = (1 if kind == "roof" else -1) * 0.2 * (1 - np.abs(2 * v[:, 0] - 1))
    at = random.integers(len(v))
    v[at] -= dent * (v[at] if kind in ("ball", "box") else np.array([0.0, 0.0, 1.0]))
    v = 10.0**exponent * (v @ Rotation.random(rng=random).as_matrix().T)
    mesh = mesh_of(v, faces)
    assert is_convex(mesh) is bool(by_hand(mesh))


@pytest.mark.parametrize("shape", [ball, sheet])
def test_a_fine_mesh_with_one_dent(shape):
    """Where none of the faces that are tried first has a vertex before it."""
    v, faces = shape(180)
    assert len(faces) > 64000
    assert is_convex(mesh_of(v, faces))
    tried = set(np.linspace(0, len(faces) - 1, TRIED).astype(int))
    at = next(k for k in range(len(v) // 2, len(v)) if not tried & set(np.flatnonzero((faces == k).any(axis=1))))
    dented = v.copy()
    dented[at] -= 1e-4 * (v[at] if shape is ball else np.array([0.0, 0.0, 1.0]))
    assert not is_convex(mesh_of(dented, faces))
