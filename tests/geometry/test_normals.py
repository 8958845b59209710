"""Vertex normals: unit, indifferent to tessellation, and out of every face where that can be."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.normals import face_normals, vertex_normals


def umbrella(heights: list[float], radii: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """A closed fan of triangles around vertex 0 at the origin."""
    count = len(heights)
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.stack([radii * np.cos(angle), radii * np.sin(angle), heights], axis=1)
    i = np.arange(count)
    return np.concatenate([np.zeros((1, 3)), rim]), np.stack([0 * i, i + 1, (i + 1) % count + 1], axis=1)


def test_the_corner_of_a_cube_does_not_see_its_diagonals():
    cube = trimesh.creation.box()
    normals, turned = vertex_normals(np.array(cube.vertices), np.array(cube.faces))
    np.testing.assert_allclose(normals, np.sign(cube.vertices) / np.sqrt(3), atol=1e-15)
    assert turned == 0


def test_a_vertex_whose_faces_cancel_has_some_unit_normal():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    normals, turned = vertex_normals(points, np.array([[0, 1, 2], [0, 2, 1], [1, 3, 2], [1, 2, 3]]))
    np.testing.assert_allclose(np.abs(normals), [[0, 0, 1]] * 4)
    assert turned == 0


def test_a_blunt_average_is_turned_out_of_the_steep_face():
    points, faces = umbrella([0.0, 0, 0, 0, 0.5, 0, 0, 0], [1.0, 1, 1, 1, -1, 1, 1, 1])
    m = face_normals(points, faces)
    normals, turned = vertex_normals(points, faces)
    assert turned == 3 and (m @ normals[0]).min() > 0.2
    assert (m @ [0.0, 0, 1]).min() < 0  # where nearly all of its faces look


@settings(deadline=None)
@given(
    st.integers(3, 9).flatmap(
        lambda n: st.tuples(*[st.lists(st.floats(a, 3), min_size=n, max_size=n) for a in (-3, 0.3)])
    )
)
def test_normals_leave_every_face_where_a_direction_does(fan: tuple[list[float], list[float]]):
    points, faces = umbrella(*fan)
    m = face_normals(points, faces)
    normals, _ = vertex_normals(points, faces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-14)
    tried = np.random.default_rng(0).normal(size=(20000, 3))
    best = (tried / np.linalg.norm(tried, axis=1, keepdims=True) @ m.T).min(axis=1).max()
    assert (m @ normals[0]).min() >= min(0.1, best - 0.02)
