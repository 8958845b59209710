"""A refined mesh is the same surface; an image at its vertices is the image."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.geometry.mesh import Mesh, bounding_box, check_mesh, load_mesh, surface_area, uv_stretch
from mesoshell.geometry.refine import MAX_FACES, at_vertices, levels_for, refine
from mesoshell.geometry.topology import pair_edges
from mesoshell.shell.geometry.extrude import extrude
from tests.helpers import wearing

SPOT = "tests/data/spot.obj"


def square() -> Mesh:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, corners[faces][..., :2], "square")


@pytest.mark.parametrize("mesh", [square(), load_mesh(SPOT)], ids=["square", "spot"])
def test_it_is_the_same_surface(mesh: Mesh):
    fine = refine(mesh, 2)
    assert len(fine.faces) == 16 * len(mesh.faces)
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    np.testing.assert_allclose(surface_area(fine), surface_area(mesh), rtol=1e-6)
    np.testing.assert_allclose(uv_stretch(fine), uv_stretch(mesh), rtol=1e-6)
    np.testing.assert_array_equal(bounding_box(fine), bounding_box(mesh))
    open_edges = lambda m: int((~pair_edges(m.faces).opposed).sum())  # noqa: E731
    assert open_edges(fine) == 4 * open_edges(mesh)
    corner = fine.vertices[fine.faces].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    whole = mesh.vertices[mesh.faces].astype(np.float64)
    before = np.cross(whole[:, 1] - whole[:, 0], whole[:, 2] - whole[:, 0])
    np.testing.assert_allclose(normal, np.repeat(before, 16, axis=0) / 16, atol=1e-6 * np.abs(before).max())
    np.testing.assert_allclose(np.linalg.norm(fine.normals, axis=1), 1, atol=1e-6)


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_a_ramp_is_read_exactly_and_its_first_row_has_v_of_one(a: float, b: float):
    """Between the middles of its outermost pixels."""
    mesh = square()
    mesh = Mesh(mesh.vertices, mesh.faces, (0.05 + 0.9 * mesh.uv).astype(np.float32), mesh.normals, ())
    size = 16
    at = (np.arange(size) + 0.5) / size
    image = 0.5 + 0.2 * (a * at[None] + b * (1 - at)[:, None])
    fine = refine(mesh, 3)
    corner = np.zeros((len(fine.vertices), 2))
    corner[fine.faces.ravel()] = fine.uv.reshape(-1, 2)
    np.testing.assert_allclose(at_vertices(fine, image), 0.5 + 0.2 * (a * corner[:, 0] + b * corner[:, 1]), atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (7, 1)])
def test_images_of_a_pixel_and_of_one_row(shape: tuple[int, int]):
    image = np.linspace(0, 1, shape[0] * shape[1]).reshape(shape)
    found = at_vertices(refine(square(), 2), image)
    assert found.min() >= 0 and found.max() <= 1 and np.ptp(found) == pytest.approx(np.ptp(image))


def test_it_is_as_fine_as_the_image_or_as_many_faces_as_there_may_be():
    assert levels_for(square(), (2, 2)) == 0
    assert levels_for(square(), (64, 16)) == 5
    assert len(refine(square(), levels_for(square(), (4096, 4096))).faces) == MAX_FACES
    assert levels_for(load_mesh(SPOT), (4096, 4096)) == 2


def test_what_leaves_the_square_by_rounding_alone_does_not_go_round():
    mesh = refine(square(), 3)
    image = np.ones((16, 16))
    image[:, :4] = 0
    shifted = [replace(mesh, uv=(mesh.uv + np.float32(by)).astype(np.float32)) for by in (1e-6, 3.0, 3.5)]
    found = [at_vertices(x, image) for x in (mesh, *shifted)]
    np.testing.assert_allclose(found[1], found[0], atol=1e-4)
    inside = (mesh.vertices[:, 0] > 0.01) & (mesh.vertices[:, 0] < 0.99)
    np.testing.assert_allclose(found[2][inside], found[0][inside], atol=1e-4)
    assert found[3][mesh.vertices[:, 0] == 0.5].max() == 0.5  # between white and black, around the border
    assert found[3][np.isclose(mesh.vertices[:, 0], 0.625)].max() == 0


def test_it_stops_where_single_precision_ends():
    """Far from the origin points fall together; a sliver among many does not stop the others."""
    far = wearing.moved(square(), 2e6, 5e6, 0.0)
    fine = refine(far, 6)
    corner = fine.vertices[fine.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    assert len(fine.faces) < 2 * 4**6 and (area == 0).mean() <= 1e-3


def test_a_flat_face_does_not_keep_others_from_growing():
    grid = refine(square(), 4)
    points = grid.vertices.copy()
    points[grid.faces[0, 0]] = (points[grid.faces[0, 1]] + points[grid.faces[0, 2]]) / 2
    flat = replace(grid, vertices=points)
    assert len(extrude(flat, 0.1, 0.1).faces) >= len(grid.faces) - 6
