"""Tangent frames: the edges of a triangle come back from them, and degenerate charts get an honest stand-in."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.frames import tangent_frames

TRIANGLE = np.array([[0, 1, 2]])
unit = st.integers(-64, 64).map(lambda i: i / 64)
plane = st.lists(st.tuples(unit, unit), min_size=3, max_size=3).map(np.array)
space = st.lists(st.tuples(unit, unit, unit), min_size=3, max_size=3).map(np.array)


def doubled_area(uv: np.ndarray) -> float:
    (a, b), (c, d) = uv[1:] - uv[0]
    return a * d - b * c


def test_a_scaled_and_mirrored_chart():
    points = np.array([[1, 1, 5], [4, 1, 5], [1, 3, 5]], np.float32)
    uv = np.array([[[0, 0], [0.5, 0], [0, 1]], [[0, 0], [0, 0.5], [1, 0]]], np.float32)
    frames = tangent_frames(points, np.array([[0, 1, 2], [0, 1, 2]]), uv)
    np.testing.assert_array_equal(frames.along_u, [[6, 0, 0], [0, 2, 0]])
    np.testing.assert_array_equal(frames.along_v, [[0, 2, 0], [6, 0, 0]])
    np.testing.assert_array_equal(frames.normal, [[0, 0, 1]] * 2)
    assert frames.mirrored.tolist() == [False, True] and frames.made_up_count == 0


@settings(deadline=None)
@given(space, plane)
def test_edges_come_back(points: np.ndarray, uv: np.ndarray):
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    if not normal.any():
        return
    frames = tangent_frames(points, TRIANGLE, uv[None])
    np.testing.assert_allclose(frames.normal[0], normal / np.linalg.norm(normal), atol=1e-6)
    assert frames.made_up[0] == (doubled_area(uv) == 0)
    assert frames.mirrored[0] == (doubled_area(uv) < 0)
    if frames.made_up[0]:
        basis = np.stack([frames.along_u[0], frames.along_v[0], frames.normal[0]]).astype(np.float64)
        np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(basis) > 0
    else:
        steps = (uv[1:] - uv[0]) @ np.stack([frames.along_u[0], frames.along_v[0]]).astype(np.float64)
        size = np.abs(frames.along_u[0]).max() + np.abs(frames.along_v[0]).max()
        np.testing.assert_allclose(steps, points[1:] - points[0], atol=1e-6 * size)


def test_the_stand_in_is_sound_where_the_normal_points_down():
    points = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0]], np.float32)
    frames = tangent_frames(points, TRIANGLE, np.zeros((1, 3, 2), np.float32))
    assert frames.normal[0].tolist() == [0, 0, -1] and frames.made_up_count == 1
    np.testing.assert_allclose(np.cross(frames.along_u[0], frames.along_v[0]), [0, 0, -1], atol=1e-7)
