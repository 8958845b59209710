"""Extrusion: offsets, patches and neighbours by hand on small meshes, laws on large ones, and every note and fault."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, check_mesh, load_mesh, uv_stretch
from mesoshell.shell.geometry import extrude as extrusion
from mesoshell.shell.geometry.extrude import Shell, extrude, first_fold, proportions

DATA = Path(__file__).parents[2] / "data"
SPOT = load_mesh(DATA / "spot.obj")
BALL = trimesh.creation.icosphere(2)
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def mesh_of(points: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh whose every triangle covers the same half of the UV square."""
    return check_mesh(points, faces, np.tile([[0.0, 0], [1, 0], [0, 1]], (len(faces), 1, 1)), "mesh")


def square(size: float = 1.0) -> Mesh:
    return check_mesh(size * POINTS, FACES, POINTS[FACES][..., :2], "square")


def test_a_square_by_hand():
    shell = extrude(square(), 0.5, 0.25)
    np.testing.assert_array_equal(shell.base, POINTS)
    np.testing.assert_array_equal(shell.offset, [[0, 0, 0.5]] * 4)
    np.testing.assert_array_equal(shell.uv, 4 * POINTS[FACES][..., :2])
    assert shell.neighbour.tolist() == [[-1, -1, 1], [0, -1, -1]]
    assert shell.neighbour_edge.tolist() == [[-1, -1, 0], [2, -1, -1]]
    assert shell.mesh_face.tolist() == [0, 1] and shell.notes == ()
    kinds = [x.dtype for x in (shell.base, shell.offset, shell.uv, shell.faces, shell.neighbour, shell.neighbour_edge)]
    assert kinds == [np.float32] * 3 + [np.int32] * 3


@pytest.mark.parametrize(
    ("height", "thickness", "scale", "expected"),
    [
        (1.0, None, None, (0.2, 0.2)),
        (0.5, None, None, (0.2, 0.4)),
        (0.5, 3.0, None, (3.0, 6.0)),
        (0.5, None, 3.0, (1.5, 3.0)),
        (0.5, 3.0, 2.0, (3.0, 2.0)),
    ],
)
def test_what_is_not_given_is_in_proportion(height: float, thickness, scale, expected: tuple[float, float]):
    """A square whose diagonal is 5: 1/25 of that is 0.2."""
    assert proportions(square(5 / 2**0.5), height, thickness, scale) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_the_option_that_is_wrong_is_named(wrong: float):
    for name, given_ in (("thickness", (wrong, None)), ("scale", (None, wrong)), ("scale", (1.0, wrong))):
        with pytest.raises(InputError, match=f"^{name}: must be positive and finite, not {wrong:g}$"):
            proportions(square(), 1.0, *given_)


def test_a_thickness_at_each_vertex():
    thickness = np.array([0.5, 0.25, 1.0, 0.125])
    np.testing.assert_array_equal(extrude(square(), thickness, 1.0).offset[:, 2], thickness)


@pytest.mark.parametrize(
    ("scale", "patches", "note"),
    [
        (1 / 3, 3, None),
        (1 / 3.1, 3, None),
        (1 / 2.9, 3, None),
        (1 / 3.4, 3, "patches are 0.333 wide, not 0.294, so that a UV unit holds a whole number of them (3)"),
        (0.7, 1, "patches are 1 wide, not 0.7, so that a UV unit holds a whole number of them (1)"),
        (1.0, 1, None),
        (1.6, 1 / 1.6, None),
        (100.0, 0.01, None),
    ],
)
def test_a_whole_number_of_patches_where_one_fits(scale: float, patches: float, note: str | None):
    shell = extrude(square(), 0.1, scale)
    np.testing.assert_allclose(shell.uv, patches * POINTS[FACES][..., :2], rtol=1e-6)
    assert shell.notes == (() if note is None else (note,))


@pytest.mark.parametrize(
    ("thickness", "scale", "fault"),
    [
        (0.0, 1.0, "thickness: must be positive and finite, not 0"),
        (-1.0, 1.0, "thickness: must be positive and finite, not -1"),
        (np.nan, 1.0, "thickness: must be positive and finite, not nan"),
        (np.inf, 1.0, "thickness: must be positive and finite, not inf"),
        (np.array([1.0, 1, 0, 1]), 1.0, "thickness: must be positive and finite, not 0 (vertex 2)"),
        (np.ones(5), 1.0, "thickness: has 5 values for 4 vertices"),
        (1.0, 0.0, "scale: must be positive and finite, not 0"),
        (1.0, np.nan, "scale: must be positive and finite, not nan"),
        (1.0, np.inf, "scale: must be positive and finite, not inf"),
    ],
)
def test_faults_name_the_option(thickness: float | np.ndarray, scale: float, fault: str):
    with pytest.raises(InputError) as raised:
        extrude(square(), thickness, scale)
    assert str(raised.value) == fault


def assert_linked(shell: Shell):
    """Neighbours are an involution, share the edge in opposite directions, and no such edge is left a border."""
    p, k = np.nonzero(shell.neighbour >= 0)
    q, m = shell.neighbour[p, k], shell.neighbour_edge[p, k]
    np.testing.assert_array_equal(shell.neighbour[q, m], p)
    np.testing.assert_array_equal(shell.neighbour_edge[q, m], k)
    np.testing.assert_array_equal(shell.faces[p, k], shell.faces[q, (m + 1) % 3])
    np.testing.assert_array_equal(shell.faces[q, m], shell.faces[p, (k + 1) % 3])
    np.testing.assert_array_equal(shell.neighbour < 0, shell.neighbour_edge < 0)
    a, b = shell.faces, np.roll(shell.faces, -1, axis=1)
    directed = [(int(x), int(y)) for x, y in zip(a[shell.neighbour < 0], b[shell.neighbour < 0], strict=True)]
    assert not any(
        (y, x) in set(directed) and directed.count((x, y)) == 1 == directed.count((y, x)) for x, y in directed
    )


@settings(deadline=None)
@given(st.sets(st.integers(0, 319), min_size=1, max_size=40), st.floats(0.01, 3))
def test_neighbours_are_an_involution(holes: set[int], thickness: float):
    mesh = mesh_of(np.array(BALL.vertices), np.delete(BALL.faces, list(holes), axis=0))
    shell = extrude(mesh, thickness, 1.0)
    assert_linked(shell)
    assert len(shell.faces) == 320 - len(holes)
    assert (shell.neighbour < 0).any()


def test_spot_is_closed_and_carries_a_prism_on_every_face():
    shell = extrude(SPOT, 0.05, 0.1)
    assert_linked(shell)
    assert (shell.neighbour >= 0).all()
    np.testing.assert_array_equal(shell.mesh_face, np.arange(len(SPOT.faces)))
    np.testing.assert_array_equal(shell.faces, SPOT.faces)
    np.testing.assert_array_equal(shell.base, SPOT.vertices)
    np.testing.assert_allclose(shell.uv, 34 * SPOT.uv, rtol=1e-6)
    lengths = np.linalg.norm(shell.offset.astype(np.float64), axis=1)
    reduced = lengths < 0.05 * (1 - 1e-6)
    assert lengths.max() <= 0.05 * (1 + 1e-6) and 0 < reduced.mean() < 0.15
    least = f"least factor {lengths.min() / 0.05:.2g}"
    note = f"thickness reduced at {reduced.sum()} of 2930 vertices, where the shell would fold ({least})"
    assert shell.notes == (note,)


@pytest.mark.parametrize("size", [2.0**-60, 2.0**-7, 8.0, 2.0**60])
def test_offsets_scale_with_the_mesh(size: float):
    scaled = Mesh(SPOT.vertices * np.float32(size), SPOT.faces, SPOT.uv, SPOT.normals, ())
    shell, small = extrude(scaled, 0.1 * size, 0.1 * size), extrude(SPOT, 0.1, 0.1)
    np.testing.assert_array_equal(shell.offset, small.offset * np.float32(size))
    np.testing.assert_array_equal(shell.uv, small.uv)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_first_fold_is_where_the_least_cross_section_is_reached(seed: int):
    rng = np.random.default_rng(seed)
    base, faces = rng.normal(size=(3, 3)), np.array([[0, 1, 2]])
    normal = np.cross(base[1] - base[0], base[2] - base[0])
    offset = normal / np.linalg.norm(normal) + 0.5 * rng.normal(size=(3, 3))
    found = first_fold(base, offset, faces)[0]
    x = np.linspace(0, 20, 20001)[:, None, None]
    moved = base + x * offset
    section = np.cross(moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0]) @ offset.T
    small = (section <= 0.01 * np.linalg.norm(normal) * np.linalg.norm(offset, axis=1)).any(axis=1)
    seen = np.argmax(small) * 1e-3 if small.any() else np.inf
    if np.isfinite(seen):
        assert seen - 1e-3 <= found <= seen + 1e-9
    else:
        assert found > 19.9


def test_surfaces_that_touch_have_posts_of_their_own():
    mesh = load_mesh(DATA / "cross.obj")
    shell = extrude(mesh, 0.1, uv_stretch(mesh))
    assert_linked(shell)
    assert shell.notes == ("2 vertices where several surfaces touch: each surface has its own posts there",)
    assert len(shell.base) == len(mesh.vertices) + 4 and len(shell.faces) == len(mesh.faces)
    np.testing.assert_array_equal(shell.base[shell.faces], mesh.vertices[mesh.faces])
    shared = np.flatnonzero((shell.base[:, :2] == 0).all(axis=1))
    assert len(shared) == 6
    assert (shell.neighbour >= 0).sum(axis=1).tolist()[:6] == [1] * 6
    normal = np.cross(*np.moveaxis(shell.base[shell.faces[:6]][:, 1:] - shell.base[shell.faces[:6]][:, :1], 1, 0))
    np.testing.assert_allclose(shell.offset[shell.faces[:6]], np.repeat(0.1 * normal[:, None], 3, axis=1), atol=1e-6)


def test_a_one_sided_surface_is_extruded_up_to_its_cut():
    i = np.arange(16)
    t = np.pi * i / 8
    across = np.stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)], axis=1)
    middle = 3 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    j, k = np.where(i == 15, 16, i + 1), np.where(i == 15, 0, i + 17)
    faces = np.concatenate([np.stack([i, j, k], 1), np.stack([i, k, i + 16], 1)])
    mesh = mesh_of(np.concatenate([middle - across, middle + across]), faces)
    shell = extrude(mesh, 0.05, uv_stretch(mesh))
    assert_linked(shell)
    assert len(shell.faces) == 32 and (shell.neighbour < 0).sum() == 32 + 2
    assert shell.notes == ("2 vertices where several surfaces touch: each surface has its own posts there",)


def test_faces_that_cannot_be_extruded_are_left_out_and_said():
    # a closed body without thickness: at its rim, no direction leaves both of its sides
    points = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    both = mesh_of(np.concatenate([points, POINTS + np.array([9, 0, 0])]), np.concatenate([faces, FACES + 4]))
    shell = extrude(both, 0.1, uv_stretch(both))
    said = "1 of 6 faces left out (first: face 0): they fold at any thickness, because a vertex normal lies below them"
    assert shell.notes == (said,)
    assert shell.mesh_face.tolist() == [1, 2, 3, 4, 5]
    assert shell.neighbour.tolist() == [[-1, 1, 2], [-1, 2, 0], [-1, 0, 1], [-1, -1, 4], [3, -1, -1]]
    np.testing.assert_allclose(shell.uv, both.uv[1:], rtol=1e-6)


def test_a_prism_that_is_still_folded_in_the_end_is_left_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(extrusion, "ROUNDS", 0)
    shell = extrude(SPOT, 0.05, 0.1)
    raw = np.float32(0.05) * SPOT.normals
    standing = first_fold(SPOT.vertices.astype(float), raw.astype(float), SPOT.faces) >= 1
    assert 0 < len(shell.faces) < len(SPOT.faces)
    np.testing.assert_array_equal(shell.mesh_face, np.flatnonzero(standing))
    assert_linked(shell)


def test_a_mesh_that_cannot_be_extruded_at_all_is_refused():
    good = square()
    lying = Mesh(good.vertices, good.faces, good.uv, np.array([[1, 0, 0]] * 4, np.float32), ())
    with pytest.raises(
        InputError, match=r"^thickness: no face that is to grow can be extruded: vertex normals lie below"
    ):
        extrude(lying, 0.1, 1.0)
