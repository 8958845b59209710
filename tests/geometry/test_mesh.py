"""A checked mesh: mends are said, what cannot be used is one line, and files of all formats give the same mesh."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from trimesh.visual import TextureVisuals

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, bounding_box, check_mesh, load_mesh, surface_area, uv_stretch

DATA = Path(__file__).parents[1] / "data"
SPOT = load_mesh(DATA / "spot.obj")
SUZANNE = load_mesh(DATA / "suzanne.obj")
BALL = trimesh.creation.icosphere(1)
#: A unit square of two triangles with its own coordinates as UVs.
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = POINTS[FACES][..., :2]


def flat_uv(faces: np.ndarray) -> np.ndarray:
    return np.tile([[0.0, 0], [1, 0], [0, 1]], (len(faces), 1, 1))


def cross_obj() -> str:
    """Three unit quads that meet in one edge, each with a UV square of its own, and an open sheet of four quads."""
    lines = ["v 0 0 0", "v 0 0 1", "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    for k, (x, y) in enumerate(((1, 0), (-0.5, 0.866025), (-0.5, -0.866025))):
        lines += [f"v {x} {y} 0", f"v {x} {y} 1", f"f 1/1 {2 * k + 3}/2 {2 * k + 4}/3 2/4"]
    lines += [f"v {2 + i} {j} 0\nvt {i / 2} {j / 2}" for i in range(3) for j in range(3)]
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        corners = [3 * a + b for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))]
        lines.append("f " + " ".join(f"{c + 9}/{c + 5}" for c in corners))
    return "\n".join(lines) + "\n"


def test_spot_needs_no_mending():
    assert (SPOT.vertices.shape, SPOT.faces.shape, SPOT.notes) == ((2930, 3), (5856, 3), ())
    assert (SPOT.vertices.dtype, SPOT.faces.dtype, SPOT.uv.dtype) == (np.float32, np.int32, np.float32)
    np.testing.assert_allclose(bounding_box(SPOT)[1], [0.471552, 0.953646, 1.049])
    assert len(np.unique(SPOT.uv.reshape(-1, 2), axis=0)) > len(SPOT.vertices)  # seams live at corners


def test_suzanne_says_what_was_mended():
    assert SUZANNE.notes[:2] == (
        "1 repeated face dropped (first: index 270)",
        "1 edge with more than two faces: a border, except between faces of one surface (first: vertices 138, 70)",
    )
    assert SUZANNE.notes[2].startswith("no UVs: unwrapped with xatlas into ")
    assert SUZANNE.notes[3] == "normals of 24 vertices turned to point out of every face around"


def test_cross_is_what_its_generator_makes():
    assert (DATA / "cross.obj").read_text() == cross_obj()
    mesh = load_mesh(DATA / "cross.obj")
    assert mesh.vertices.shape == (17, 3) and mesh.faces.shape == (14, 3)
    assert mesh.notes == (
        "1 edge with more than two faces: a border, except between faces of one surface (first: vertices 1, 0)",
    )


def test_sizes_of_the_unit_square():
    mesh = check_mesh(3 * POINTS, FACES, UV / 2, "square")
    assert surface_area(mesh) == 9 and uv_stretch(mesh) == 6
    np.testing.assert_array_equal(bounding_box(mesh), [[0, 0, 0], [3, 3, 0]])


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb", "stl"])
def test_round_trip(tmp_path: Path, suffix: str):
    corners = trimesh.Trimesh(
        SPOT.vertices[SPOT.faces].reshape(-1, 3), np.arange(SPOT.faces.size).reshape(-1, 3), process=False
    )
    corners.visual = TextureVisuals(uv=SPOT.uv.reshape(-1, 2))
    path = tmp_path / f"spot.{suffix}"
    if suffix == "obj":
        corners.export(str(path), digits=9)
    else:
        corners.export(str(path))
    back = load_mesh(path)
    assert len(back.vertices) == len(SPOT.vertices)
    np.testing.assert_allclose(back.vertices[back.faces], SPOT.vertices[SPOT.faces], atol=1e-7)
    if suffix == "stl":
        assert len(back.notes) == 1 and back.notes[0].startswith("no UVs: unwrapped with xatlas into ")
    else:
        assert back.notes == ()
        np.testing.assert_allclose(back.uv, SPOT.uv, atol=1e-7)


@pytest.mark.parametrize(
    ("points", "faces", "fault"),
    [
        (POINTS, FACES[:0], "has no faces"),
        (POINTS[:0], FACES[:0], "has no faces"),
        (POINTS + np.array([[0], [np.nan], [0], [0]]), FACES, r"vertex 1 is not finite: \[nan, nan, nan\]"),
        (
            POINTS + np.array([[0, 0, 0], [0, 0, 0], [0, np.inf, 0], [0, 0, 0]]),
            FACES,
            r"vertex 2 is not finite: \[1.0, inf, 0.0\]",
        ),
        (POINTS * np.array([[1], [1], [1], [1e39]]), FACES, r"vertex 3 is not finite: \[0.0, 1e\+39, 0.0\]"),
        (POINTS, FACES + np.array([[0], [1]]), "face 1 refers to vertex 4, but there are 4"),
        (POINTS, FACES - np.array([[1], [0]]), "face 0 refers to vertex -1, but there are 4"),
        (0 * POINTS, FACES, "every one of its 2 faces has zero area"),
    ],
)
def test_what_cannot_be_used_is_one_line(points: np.ndarray, faces: np.ndarray, fault: str):
    with pytest.raises(InputError, match=f"^square: {fault}$"):
        check_mesh(points, faces, None, "square")


def notes_of(faces: np.ndarray, points: np.ndarray = POINTS) -> tuple[str, ...]:
    return check_mesh(points, faces, flat_uv(faces), "mesh").notes


def test_each_thing_that_is_mended_is_said():
    assert notes_of(np.array([[0, 1, 2], [0, 1, 1], [0, 2, 3], [3, 3, 3]])) == (
        "2 zero-area faces dropped (first: index 1)",
    )
    assert notes_of(np.array([[0, 1, 2], [0, 2, 3], [3, 0, 2]])) == ("1 repeated face dropped (first: index 2)",)
    assert notes_of(np.array([[0, 1, 2], [0, 3, 2]])) == ("winding of 1 face flipped to agree with the neighbours",)
    assert notes_of(BALL.faces[:, ::-1], BALL.vertices) == ("the whole mesh was inside out: flipped",)
    two, apart = np.concatenate([BALL.faces, BALL.faces[:, ::-1] + 42]), BALL.vertices + np.array([3, 0, 0])
    said = ("1 of 2 separate parts were inside out: flipped",)
    assert notes_of(two, np.concatenate([BALL.vertices, apart])) == said


def test_a_one_sided_surface_is_said():
    i = np.arange(8)
    t = np.pi * i / 4
    across = np.stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)], axis=1)
    middle = 3 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    j, k = np.where(i == 7, 8, i + 1), np.where(i == 7, 0, i + 9)
    faces = np.concatenate([np.stack([i, j, k], 1), np.stack([i, k, i + 8], 1)])
    said = ("16 faces form a one-sided surface: it is cut where opposite windings meet",)
    assert notes_of(faces, np.concatenate([middle - across, middle + across])) == said


def test_uvs_that_cannot_be_used_are_replaced_and_it_is_said():
    holed = UV.copy()
    holed[1, 2, 0] = np.nan
    for uv, said in (
        (None, "no UVs: unwrapped with xatlas into 1 chart"),
        (holed, "1 face without finite UVs (first: index 1): unwrapped with xatlas into 1 chart"),
        (0 * UV, "UVs without area: unwrapped with xatlas into 1 chart"),
    ):
        mesh = check_mesh(POINTS, FACES, uv, "square")
        assert mesh.notes == (said,) and 0 < uv_stretch(mesh) < 1.2
    partly = np.stack([UV[0], 0 * UV[1]])
    mesh = check_mesh(POINTS, FACES, partly, "square")
    assert mesh.notes == ("1 face without area in UV (first: index 1)",)
    np.testing.assert_array_equal(mesh.uv, partly)


def test_uvs_follow_a_flipped_face():
    mesh = check_mesh(POINTS, np.array([[0, 1, 2], [0, 3, 2]]), POINTS[[[0, 1, 2], [0, 3, 2]]][..., :2], "square")
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][..., :2], mesh.uv)


def test_positions_are_welded_bit_by_bit():
    near = np.nextafter(np.float32(1), np.float32(2))
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0], [0, 1, -0.0], [0, 0, 1], [near, 0, 0]])
    mesh = check_mesh(points, np.array([[0, 1, 2], [3, 4, 5], [2, 6, 0]]), flat_uv(np.zeros((3, 3))), "mesh")
    assert len(mesh.vertices) == 5
    assert set(mesh.faces[0]) & set(mesh.faces[1]) == {0, 2}
    assert not set(mesh.faces[1]) & set(mesh.faces[2]) - {0, 2}


def assert_sound(mesh: Mesh):
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    np.testing.assert_array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals.astype(np.float64), axis=1), 1, atol=2e-7)
    assert (np.sort(mesh.faces, axis=1)[:, 1:] > np.sort(mesh.faces, axis=1)[:, :-1]).all()


@settings(deadline=None)
@given(st.lists(st.tuples(*[st.tuples(*[st.integers(-2, 2)] * 3)] * 3), min_size=1, max_size=12))
def test_any_soup_of_triangles_is_sound_or_refused(soup: list):
    points = np.array(soup, float).reshape(-1, 3)
    faces = np.arange(len(points)).reshape(-1, 3)
    areas = np.linalg.norm(np.cross(*np.moveaxis(points[faces][:, 1:] - points[faces][:, :1], 1, 0)), axis=1)
    if not areas.any():
        with pytest.raises(InputError, match="has zero area"):
            check_mesh(points, faces, flat_uv(faces), "soup")
        return
    mesh = check_mesh(points, faces, flat_uv(faces), "soup")
    assert_sound(mesh)
    triangles = {tuple(sorted(map(tuple, t))) for t in points[faces[areas > 0]]}
    assert {tuple(sorted(map(tuple, t))) for t in mesh.vertices[mesh.faces].astype(float)} == triangles


@settings(deadline=None)
@given(st.sets(st.integers(0, 79)), st.floats(-1e3, 1e3))
def test_a_ball_comes_out_outward_however_it_was_wound(flipped: set[int], away: float):
    faces = np.array(BALL.faces)
    faces[list(flipped)] = faces[list(flipped)][:, ::-1]
    mesh = check_mesh(BALL.vertices + away, faces, flat_uv(faces), "ball")
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64) - np.float32(away), 1, 0)
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a) > 0).all()
    np.testing.assert_allclose(mesh.normals, BALL.vertices, atol=0.01)
    assert_sound(mesh)
