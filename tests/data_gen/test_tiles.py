"""Geometry of corner tiles: what crosses an edge follows from its two colours, cover is even, and the 16 fit on the torus."""

from functools import cache

import numpy as np
import pytest

from data_gen import sample, tiles
from data_gen.recipe import Growth
from data_gen.worker import RECIPES, UnusableInput, drawer_of

SETTINGS = {"recipe": "grass", "seed": 0, "size": 64, "coverage": None, "fixed": {}, "patch": None, "views": None}


@cache
def slab(name: str, tile: int) -> Growth:
    recipe = RECIPES[name]
    return tiles.slab(recipe.grow, tile, {key: p.default for key, p in recipe.parameters.items()})


def about(growth: Growth, u: float, v: float, near: float = 0.2) -> np.ndarray:
    """Middles of the pieces near a place of the slab, from there, in an order of their own."""
    middle = growth.points.mean(axis=1) - np.array([u, v, 0.0])
    found = middle[np.abs(middle[:, :2]).max(axis=1) < near]
    return found[np.lexsort(found.T.round(6))]


def crossing(growth: Growth, u: float) -> np.ndarray:
    """Pieces that cross the edge from (u, 1) to (u, 2) and no other, from its first corner."""
    thick = 0.0 if growth.radius is None else growth.radius.max(axis=1)[:, None]
    low, high = growth.points[..., :2].min(axis=1) - thick, growth.points[..., :2].max(axis=1) + thick
    chosen = (low[:, 0] < u) & (high[:, 0] >= u) & (low[:, 1] >= 1) & (high[:, 1] < 2)
    found = growth.points[chosen].mean(axis=1) - np.array([u, 1.0, 0.0])
    return found[np.lexsort(found.T.round(6))]


@pytest.mark.parametrize("name", ["grass", "fur", "carpet"])
def test_edges_of_the_same_colours_are_crossed_by_the_same_pieces(name):
    by_colours: dict[tuple, list] = {}
    for tile in range(16):
        i, j = tile % 4, tile // 4
        for side in (0, 1):
            ends = tuple(tiles.COLOURS[(j + k) % 4][(i + side) % 4] for k in (0, 1))
            by_colours.setdefault(ends, []).append(crossing(slab(name, tile), 1.0 + side))
    assert len(by_colours) == 4 and all(len(found) == 8 and len(found[0]) > 5 for found in by_colours.values())
    for first, *others in by_colours.values():
        for other in others:
            np.testing.assert_allclose(first, other, atol=1e-9)
    first = [found[0] for found in by_colours.values()]
    assert not any(a.shape == b.shape and np.allclose(a, b) for k, a in enumerate(first) for b in first[:k])


def test_neighbours_on_the_torus_show_the_same_plane():
    """What is one patch to the right in a tile's slab is in the middle of its neighbour's."""
    here, there = slab("grass", 5), slab("grass", 6)
    for u, v in ((1.5, 1.5), (1.0, 1.2), (1.2, 1.0), (1.7, 1.7)):
        np.testing.assert_allclose(about(here, u + 1, v), about(there, u, v), atol=1e-9)
        assert len(about(there, u, v)) > 10


def test_cover_is_as_even_as_a_lawn_s():
    """Pieces a patch, over all tiles; and in the inner, edge and corner parts of tiles alike."""
    middles = [slab("grass", t).points.mean(axis=1)[:, :2] - 1 for t in range(16)]
    inside = [m[((m >= 0) & (m < 1)).all(axis=1)] for m in middles]
    counts = np.array([len(m) for m in inside])
    assert abs(counts.mean() - 220) < 6 and counts.std() < 20
    places = np.concatenate(inside)
    across, _, _ = np.histogram2d(*places.T, bins=5, range=[[0, 1]] * 2)
    share = across / across.mean()
    assert share.min() > 0.75 and share.max() < 1.25


def test_a_tile_s_sample_is_the_tile_in_turn_with_one_geometry():
    drawer = drawer_of(SETTINGS | {"recipe": "carpet8", "tiles": True})
    draws = [drawer.draw(i) for i in range(20)]
    assert [d.instance for d in draws] == [*range(16), *range(4)] and {d.side for d in draws} == {3}
    roles = {name: p.role for name, p in RECIPES["carpet8"].parameters.items()}
    for name, role in roles.items():
        assert len({d.parameters[name] for d in draws}) == (20 if role == "alpha" else 1), name
    plain = sample.Drawer(RECIPES["carpet8"], 0, drawer.coverage, {}, None).draw(3)
    np.testing.assert_array_equal(plain.camera_to_world, draws[3].camera_to_world)


def test_pieces_longer_than_a_patch_cannot_be_tiled():
    def grow(rng, side, values):
        return Growth(np.array([[[0.5, 0.5, 0.0], [2.6, 0.5, 0.5]]]), np.array([[0, 1]]), np.array([0, 1.0]), None, {})

    with pytest.raises(ValueError, match="longer than a patch"):
        tiles.slab(grow, 0, {})
    RECIPES["long"] = RECIPES["grass"]._replace(name="long", grow=grow)
    try:
        with pytest.raises(UnusableInput, match="long cannot be tiled: a piece is longer"):
            drawer_of(SETTINGS | {"recipe": "long", "tiles": True})
    finally:
        del RECIPES["long"]
