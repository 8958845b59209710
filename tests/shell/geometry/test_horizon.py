"""The least cosine between a light and the faces of a shell."""

import numpy as np
import pytest
import trimesh

from mesoshell.geometry.mesh import check_mesh
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.horizon import lowest


def test_known_angles() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    square = extrude(check_mesh(corners, faces, corners[faces][..., :2], "square"), 1.0, 1.0)
    lights = np.array([[0, 0.6, 0.8], [0, 0, 1], [1, 0, 0.0]])
    for n, cosine in ((0, 1.0), (1, 0.8), (2, 0.8), (3, 0.0)):
        assert lowest(square, lights[:n]) == pytest.approx(cosine, abs=1e-7)


def test_a_closed_body_has_a_face_that_looks_away() -> None:
    made = trimesh.creation.icosphere(2)
    ball = extrude(check_mesh(made.vertices, made.faces, made.vertices[made.faces][..., :2], "ball"), 0.1, 1.0)
    toward = np.random.default_rng(0).normal(size=(1, 3))
    assert lowest(ball, toward / np.linalg.norm(toward)) < -0.95
