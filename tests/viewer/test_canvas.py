"""A brush reaches what is near in space, and an image gets it where renderers look it up."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.geometry.mesh import Mesh, check_mesh, load_mesh
from mesoshell.viewer.canvas import Canvas, Hit
from tests.helpers.stability.surfaces import ball

SPOT = Path(__file__).parents[2] / "src" / "mesoshell" / "assets" / "spot.obj"
SIDE = 128


def square(uv: np.ndarray) -> Mesh:
    """[0, 1]² in the plane z = 0, with these texture coordinates of its four corners."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return check_mesh(corners, faces, uv[faces], "square")


UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


@pytest.fixture(scope="module")
def plain() -> Canvas:
    return Canvas(square(UNIT), shape=(SIDE, SIDE))


def above(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x, y, 2.0]), np.array([0.0, 0.0, -1.0])


def hit(canvas: Canvas, x: float, y: float) -> Hit:
    found = canvas.hit(*above(x, y))
    assert found is not None
    return found


def looked_up(image: np.ndarray, u: float, v: float) -> float:
    """As kernels look an image up."""
    height, width = image.shape
    return float(image[min(int((1 - v % 1) * height), height - 1), min(int(u % 1 * width), width - 1)])


def test_a_ray_meets_the_mesh_or_misses(plain: Canvas):
    np.testing.assert_allclose(hit(plain, 0.3, 0.8).point, [0.3, 0.8, 0], atol=1e-6)
    assert plain.hit(*above(1.2, 0.5)) is None


@given(st.floats(0.2, 0.8), st.floats(0.2, 0.8))
def test_a_dab_lands_where_it_is_drawn(x: float, y: float):
    canvas = Canvas(square(UNIT), shape=(SIDE, SIDE))
    image = canvas.dab(np.zeros((SIDE, SIDE), np.float32), hit(canvas, x, y), 0.15, 1.0)
    v, u = np.meshgrid(1 - (np.arange(SIDE) + 0.5) / SIDE, (np.arange(SIDE) + 0.5) / SIDE, indexing="ij")
    r = np.hypot(u - x, v - y)
    exact = np.where(r < 0.15, (1 - (r / 0.15) ** 2) ** 2, 0)
    np.testing.assert_allclose(image, exact, atol=0.12)  # a texel's width of the steepest slope
    assert (image[r > 0.15 + 1 / SIDE] == 0).all() and looked_up(image, x, y) > 0.95


def test_every_texel_of_the_mesh_can_be_painted():
    canvas = Canvas(load_mesh(SPOT), shape=(256, 256))
    image = np.zeros((256, 256), np.float32)
    for face in range(0, len(canvas._corners), 7):
        image = canvas.dab(image, Hit(canvas._corners[face].mean(axis=0), face), 0.3, 1.0)
    uv = load_mesh(SPOT).uv
    middles = uv.mean(axis=1)
    assert min(looked_up(image, *middle) for middle in middles) > 0.3


def test_a_seam_is_painted_on_both_sides():
    """Two triangles whose charts lie apart."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[[0, 0], [0.4, 0], [0.4, 0.4]], [[0.5, 0.5], [0.9, 0.9], [0.5, 0.9]]])
    canvas = Canvas(check_mesh(corners, faces, uv, "seam"), shape=(SIDE, SIDE))
    image = canvas.dab(np.zeros((SIDE, SIDE), np.float32), hit(canvas, 0.5, 0.5), 0.2, 1.0)
    assert looked_up(image, 0.21, 0.19) > 0.9 and looked_up(image, 0.69, 0.71) > 0.9
    assert looked_up(image, 0.6, 0.2) == 0
    assert looked_up(image, 0.19, 0.22) > 0.5  # outside of the chart, beside the stroke: what a filter may read


def test_what_faces_away_is_left_alone():
    front = square(UNIT / 2)
    points = np.concatenate([front.vertices, front.vertices - [0, 0, 0.01]])
    faces = np.concatenate([front.faces, front.faces[:, ::-1] + 4])
    uv = np.concatenate([front.uv, front.uv[:, ::-1] + 0.5])
    canvas = Canvas(check_mesh(points, faces, uv, "leaf"), shape=(SIDE, SIDE))
    image = canvas.dab(np.zeros((SIDE, SIDE), np.float32), hit(canvas, 0.5, 0.5), 0.2, 1.0)
    assert looked_up(image, 0.25, 0.25) > 0.9 and looked_up(image, 0.75, 0.75) == 0


def test_texture_coordinates_outside_the_square_repeat(plain: Canvas):
    canvas = Canvas(square(UNIT + np.array([3, -2])), shape=(SIDE, SIDE))
    blank = np.zeros((SIDE, SIDE), np.float32)
    moved, still = (c.dab(blank, hit(c, 0.4, 0.6), 0.1, 1.0) for c in (canvas, plain))
    np.testing.assert_allclose(moved, still, atol=0.15)  # samples on a texel's edge may lie beside it
    assert looked_up(moved, 3.4, -1.4) > 0.95


@given(st.floats(0, 6.28), st.floats(0.3, 2.0), st.booleans())
def test_a_stroke_combs_along_itself(angle: float, stretch: float, turned: bool):
    """In coordinates that are turned by a quarter, or stretched, too: (u, v) of a step along the way."""
    uv = UNIT * [stretch, 1.0]
    if turned:
        uv = np.stack([1 - uv[:, 1], uv[:, 0]], axis=1)
    canvas = Canvas(square(uv), shape=(SIDE, SIDE))
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    image = np.full((SIDE, SIDE), 0.3, np.float32)
    for _ in range(12):
        image = canvas.comb(image, hit(canvas, 0.5, 0.5), 0.1, way)
    step = np.array([stretch * way[0], way[1]])
    du, dv = (-step[1], step[0]) if turned else step
    place = uv[[0, 2]].mean(axis=0)
    off = (looked_up(image, *place) - np.arctan2(dv, du) / (2 * np.pi) + 0.5) % 1 - 0.5
    assert abs(off) < 1e-3
    assert ((image >= 0) & (image <= 1)).all()


def test_angles_turn_the_shorter_way(plain: Canvas):
    """From 350 degrees to 10, by 0."""
    image = np.full((SIDE, SIDE), 350 / 360, np.float32)
    ten = np.deg2rad(10)
    edge = np.array([np.cos(ten), np.sin(ten), 0.0])
    image = plain.comb(image, hit(plain, 0.5, 0.5), 0.2, edge) * 360
    assert ((image > 349) | (image < 11)).all()
    assert image[SIDE // 2, SIDE // 2] == pytest.approx(10, abs=1)


def test_a_brush_over_degenerate_texture_coordinates_is_finite():
    canvas = Canvas(square(np.array([[0.2, 0.2], [0.2, 0.2], [0.6, 0.7], [0.6, 0.7]])), shape=(SIDE, SIDE))
    image = canvas.comb(np.zeros((SIDE, SIDE), np.float32), hit(canvas, 0.5, 0.5), 0.3, np.array([1.0, 0.0, 0.0]))
    assert np.isfinite(image).all()


def test_what_is_drawn_on_a_shell_s_top_is_painted_under_it():
    """The top of a ball's shell: a ray beside the ball meets it."""
    mesh = ball(3, 1.0, (0.0, 0.0, 0.0))
    canvas = Canvas(mesh, 0.5, (SIDE, SIDE))
    beside = np.array([1.2, 0.0, 5.0]), np.array([0.0, 0.0, -1.0])
    assert Canvas(mesh, shape=(SIDE, SIDE)).hit(*beside) is None
    found = canvas.hit(*beside)
    assert found is not None and np.linalg.norm(found.point) == pytest.approx(1.5, abs=0.02)
    image = canvas.dab(np.zeros((SIDE, SIDE), np.float32), found, 0.3, 1.0)
    assert looked_up(image, *mesh.uv[found.face].mean(axis=0)) > 0.8
