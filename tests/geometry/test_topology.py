"""Edges, winding and fans, on surfaces small enough to count by hand."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.topology import agree, inside_out, pair_edges, split_fans

BALL = trimesh.creation.icosphere(1)
TWO = np.array([[0, 1, 2], [2, 1, 3]])


def test_edges_of_two_triangles():
    edges = pair_edges(TWO)
    assert edges.partner.tolist() == [[-1, 3, -1], [1, -1, -1]]
    assert edges.opposed.tolist() == [[False, True, False], [True, False, False]]
    assert edges.crowd.tolist() == [[1, 2, 1], [2, 1, 1]]


def test_an_edge_of_like_sides_has_a_partner_that_is_not_opposed():
    edges = pair_edges(np.array([[0, 1, 2], [1, 2, 3]]))
    assert edges.partner[0, 1] == 3 and not edges.opposed.any()


def test_an_edge_of_three_faces_has_no_partner():
    edges = pair_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    assert edges.crowd[:, 0].tolist() == [3, 3, 3] and (edges.partner == -1).all()


@settings(deadline=None)
@given(st.lists(st.integers(0, len(BALL.faces) - 1), max_size=39, unique=True))
def test_the_fewer_faces_are_flipped_and_all_agree(chosen: list[int]):
    faces = np.array(BALL.faces)
    faces[chosen] = faces[chosen][:, ::-1]
    winding = agree(pair_edges(faces))
    assert winding.flip.sum() == min(len(chosen), len(faces) - len(chosen))
    faces[winding.flip] = faces[winding.flip][:, ::-1]
    assert pair_edges(faces).opposed.all()
    assert not winding.one_sided.any() and (winding.part == 0).all()


def test_a_moebius_band_is_one_sided_and_a_sheet_beside_it_is_not():
    i = np.arange(6)
    low, high = np.stack([i, i + 1], 1), np.stack([i, i + 1], 1) + 7
    band = np.concatenate(
        [np.stack([low[:, 0], low[:, 1], high[:, 1]], 1), np.stack([low[:, 0], high[:, 1], high[:, 0]], 1)]
    )
    band[band == 6], band[band == 13] = 7, 0  # its ends meet upside down
    winding = agree(pair_edges(np.concatenate([band, TWO + 20])))
    assert winding.one_sided.tolist() == [True] * 12 + [False] * 2
    assert not winding.flip.any() and len(np.unique(winding.part)) == 2


def boxes(*placed: tuple[float, float, bool]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, faces and parts of cubes of (size, place on x, inside out)."""
    cube = trimesh.creation.box()
    points = [size * cube.vertices + [x, 0, 0] for size, x, _ in placed]
    faces = [cube.faces[:, :: -1 if out else 1] + 8 * i for i, (_, _, out) in enumerate(placed)]
    return np.concatenate(points), np.concatenate(faces), np.repeat(np.arange(len(placed)), 12)


def test_which_parts_are_inside_out():
    for placed, expected in (
        ([(1.0, 0.0, False)], [False]),
        ([(1.0, 0.0, True)], [True]),
        ([(1.0, 0.0, False), (1.0, 5.0, True)], [False, True]),
        ([(3.0, 0.0, False), (1.0, 0.0, True)], [False, False]),  # a cavity
        ([(3.0, 0.0, True), (1.0, 0.0, False)], [True, True]),  # a hollow cube, all of it turned
        ([(3.0, 1e5, True)], [True]),
    ):
        points, faces, part = boxes(*placed)
        assert inside_out(points, faces, part, pair_edges(faces)).tolist() == expected


def test_an_open_part_is_never_inside_out():
    points, faces, part = boxes((1.0, 0.0, True))
    assert not inside_out(points, faces[1:], part[1:], pair_edges(faces[1:])).any()


def test_two_cubes_that_share_an_edge_are_told_apart():
    cube = trimesh.creation.box()
    points = np.concatenate([cube.vertices, cube.vertices + np.array([1, 1, 0])])
    home = np.array([np.flatnonzero((points == p).all(axis=1))[0] for p in points])
    faces = home[np.concatenate([cube.faces, cube.faces + 8])]
    assert (pair_edges(faces).crowd == 4).sum() == 4
    split, copied = split_fans(faces, pair_edges(faces), len(points))
    assert sorted(copied) == sorted(set(home[8:]) & set(range(8)))
    assert (pair_edges(split).opposed).all()
    np.testing.assert_array_equal(np.append(np.arange(len(points)), copied)[split], faces)


def test_a_manifold_is_not_split():
    split, copied = split_fans(np.array(BALL.faces), pair_edges(np.array(BALL.faces)), len(BALL.vertices))
    assert len(copied) == 0
    np.testing.assert_array_equal(split, BALL.faces)
