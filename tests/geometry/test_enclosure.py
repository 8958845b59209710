"""How much a surface sees of surfaces: form factors that are known."""

import numpy as np
import pytest
import trimesh

from mesoshell.geometry.enclosure import enclosure
from mesoshell.geometry.mesh import Mesh, check_mesh


def ball(radius: float = 1.0, z: float = 0.0) -> Mesh:
    made = trimesh.creation.icosphere(3, radius)
    return mesh(made.vertices + np.array([0, 0, z]), made.faces)


def square(side: float, z: float, down: bool = False) -> Mesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2 + np.array([0, 0, z])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return mesh(corners, faces[:, ::-1] if down else faces)


def mesh(points: np.ndarray, faces: np.ndarray) -> Mesh:
    return check_mesh(points, faces, points[faces][..., :2], "it")


#: A ball over a plane without end sees it in half of its directions; two unit squares a unit apart see a fifth of each other.
KNOWN = [
    ([ball()], 0.0),
    ([square(1, 0)], 0.0),
    ([ball(), square(2000, -2)], 0.5),
    ([ball(), square(20000, -2)], 0.5),
    ([square(1, 0), square(1, 1, down=True)], 0.1998),
    ([ball(), ball(5.0)], 1.0),
]


@pytest.mark.parametrize(("meshes", "share"), KNOWN)
def test_form_factors_that_are_known(meshes: list[Mesh], share: float) -> None:
    assert enclosure(meshes) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_size_and_place_do_not_matter(factor: float) -> None:
    pair = [ball(), ball(0.5, 1.6)]
    moved = [mesh(factor * (m.vertices.astype(np.float64) + 7), m.faces) for m in pair]
    assert enclosure(moved) == pytest.approx(enclosure(pair), abs=0.01) and enclosure(pair) > 0.05
    assert enclosure(pair) == enclosure(pair)
