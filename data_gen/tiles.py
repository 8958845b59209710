"""Corner tiles: geometry on a torus of 4 × 4 patches, from which the whole plane can be tiled without repeats.

Notation
    corner    a point of the patch lattice, of one of two colours
    tile      a patch by the colours of its four corners: 16, each once on the torus; number i + 4 j is [i, i + 1) × [j, j + 1)
    piece     a blade or a strand; it lies in a tile, crosses one edge, or crosses two edges that meet at a corner
    lawn      what a recipe grows on a torus of one patch

Of a lawn of each tile, those pieces are taken that lie in the tile; of a lawn of each pair of colours, those that cross an
edge; of a lawn of each colour, those that cross at a corner. So what crosses an edge follows from the edge's two colours, and
two tiles that share them fit together. Every lawn is equally dense, and so is what is taken.

After Lagae and Dutré 2006, "An Alternative for Wang Tiles: Colored Edges versus Colored Corners".
"""

import itertools
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from data_gen.recipe import Growth, Values

#: Patches along a side of the torus.
SIDE = 4
#: Colour of the corner at (i, j): COLOURS[j][i].
COLOURS = ((1, 1, 1, 0), (1, 1, 0, 1), (0, 1, 0, 0), (1, 0, 0, 0))
_TILE, _ACROSS_U, _ACROSS_V, _CORNER = range(4)

Grow = Callable[[np.random.Generator, int, Values], Growth]


def slab(grow: Grow, tile: int, values: Values) -> Growth:
    """What covers [0, 3)²: a tile in the middle, and around it its neighbours on the torus.

    Raises ValueError if a piece crosses two edges that do not meet."""
    parts = []
    for kind, colours, at in _places(tile % SIDE - 1, tile // SIDE - 1):
        grown = _lawn(grow, (kind, *colours), tuple(sorted(values.items())))
        chosen, shift = _taken(grown, kind)
        points = grown.points[chosen] - shift[chosen][:, None] + np.array([*at, 0.0])
        radius = None if grown.radius is None else grown.radius[chosen]
        parts.append(grown._replace(points=points, radius=radius, own={k: v[chosen] for k, v in grown.own.items()}))
    first = parts[0]
    return first._replace(
        points=np.concatenate([p.points for p in parts]),
        radius=None if first.radius is None else np.concatenate([p.radius for p in parts]),
        own={name: np.concatenate([p.own[name] for p in parts]) for name in first.own},
    )


@lru_cache(maxsize=32)
def _lawn(grow: Grow, seed: tuple[int, ...], values: tuple[tuple[str, float], ...]) -> Growth:
    """A dataset has 26 of them."""
    return grow(np.random.default_rng(seed), 1, dict(values))


def _places(u: int, v: int) -> Iterator[tuple[int, tuple[int, ...], tuple[int, int]]]:
    """Tiles, edges and corners of the slab whose first corner is (u, v): kind, colours, and the place in the slab."""

    def colours(i: int, j: int, wide: int, high: int) -> tuple[int, ...]:
        places = itertools.product(range(high + 1), range(wide + 1))
        return tuple(COLOURS[(v + j + dj) % SIDE][(u + i + di) % SIDE] for dj, di in places)

    for i, j in itertools.product(range(4), repeat=2):
        yield _CORNER, colours(i, j, 0, 0), (i, j)
        if i < 3:
            yield _ACROSS_V, colours(i, j, 1, 0), (i, j)
        if j < 3:
            yield _ACROSS_U, colours(i, j, 0, 1), (i, j)
        if i < 3 and j < 3:
            yield _TILE, colours(i, j, 1, 1), (i, j)


def _taken(grown: Growth, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a kind (N,), and what moves each to its place about the origin (N, 3)."""
    thick = 0.0 if grown.radius is None else grown.radius.max(axis=1, keepdims=True)
    low = np.floor(grown.points[..., :2].min(axis=1) - thick)
    high = np.floor(grown.points[..., :2].max(axis=1) + thick)
    crossed = (high - low).astype(int)
    if crossed.max() > 1:
        raise ValueError("a piece is longer than a patch: no edge of a tile can own it")
    wanted = {_TILE: (0, 0), _ACROSS_U: (1, 0), _ACROSS_V: (0, 1), _CORNER: (1, 1)}[kind]
    return (crossed == wanted).all(axis=1), np.pad(high, ((0, 0), (0, 1)))
