"""Where things grow and how they bend: points, fields and noise that close on a torus.

Notation
    L         side of the torus, in patches
    t         position along a strand, 0 at the root and 1 at the tip
    field     a smooth random vector of the plane at every point, periodic in L
"""

import numpy as np


def jittered_grid(a_patch: int, side: int, rng: np.random.Generator, jitter: float = 1.0) -> np.ndarray:
    """a_patch · side² points (n, 2) in [0, side)²: at most one a cell of the smallest square grid that has the cells.

    Cells are chosen patch by patch, so cover is even. jitter: share of the cell in which a point may lie, about its
    centre.
    """
    cells = int(np.ceil(np.sqrt(a_patch)))
    patches = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), axis=-1).reshape(-1, 1, 2)
    order = rng.permuted(np.tile(np.arange(cells * cells), (side * side, 1)), axis=1)[:, :a_patch]
    corner = np.stack([order % cells, order // cells], axis=-1) + cells * patches
    offset = 0.5 + jitter * (rng.random((*order.shape, 2)) - 0.5)
    return ((corner + offset) / cells).reshape(-1, 2)


def nearest(points: np.ndarray, centres: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """For points (N, 2): the index (N,) of the nearest of the centres (M, 2) on the torus, and the way to it (N, 2)."""
    index = np.empty(len(points), np.int64)
    for part in np.array_split(np.arange(len(points)), 1 + len(points) * len(centres) // 2**18):
        dx, dy = (shortest(c - p[part, None], side) for c, p in zip(centres.T, points.T, strict=True))
        index[part] = np.argmin(dx * dx + dy * dy, axis=1)
    return index, shortest(centres[index] - points, side)


def shortest(apart: np.ndarray, side: int) -> np.ndarray:
    """Differences of coordinates on the torus, the short way round."""
    return apart - side * np.rint(apart / side)


def field(points: np.ndarray, side: int, rng: np.random.Generator, cycles: tuple[float, float]) -> np.ndarray:
    """A field (N, 2) of unit variance a component, of 24 plane waves with between cycles[0] and cycles[1] a patch."""
    steps = np.arange(-int(cycles[1] * side), int(cycles[1] * side) + 1)
    waves = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2) / side
    length = np.hypot(*waves.T)
    waves = waves[(length >= cycles[0]) & (length <= cycles[1])]
    waves = waves[rng.integers(len(waves), size=24)]
    phase = rng.uniform(0.0, 2.0 * np.pi, (24, 2))
    angle = 2.0 * np.pi * points @ waves.T
    return np.sqrt(2.0 / 24.0) * np.sin(angle[..., None] + phase).sum(axis=1)


def wander(n: int, t: np.ndarray, rng: np.random.Generator, waves: int = 4) -> np.ndarray:
    """Smooth noise (n, K, 2) along n strands at positions t (K,): 0 at the root, of about unit size at the tip."""
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 1, waves, 2))
    weight = rng.normal(size=(n, 1, waves, 2)) / np.sqrt(waves)
    angle = 2.0 * np.pi * t[None, :, None, None] * (0.5 + np.arange(waves))[:, None]
    return (weight * (np.sin(angle + phase) - np.sin(phase))).sum(axis=2) * t[None, :, None]


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def segments(points: int) -> np.ndarray:
    """(points − 1, 2): the pairs of neighbours along a strand."""
    return np.stack([np.arange(points - 1), np.arange(1, points)], axis=1)
