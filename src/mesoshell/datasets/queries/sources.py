"""Mesostructures to learn: a height map of any image file, and four that are made here (NumPy only).

Notation
D            depth of a tile, texture units                                       (datasets/queries/tile)
h            height, −D at the body and 0 at the bounding surface
cells        of a height map's grid, along u and v
rail         a curve in space that a tube or a leaf follows                       (K, 3)

Weave and scales overhang, and are no height fields; fibres lean over each other; spheres have undersides.
"""

from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.datasets.queries.tile import Tile
from mesoshell.errors import InputError
from mesoshell.io.image import read_heights

#: Most cells along a side of a height map's grid; finer texels are averaged.
CELLS = 128
#: Albedos of a height map at its deepest and at its highest.
LOW, HIGH = (0.16, 0.10, 0.07), (0.62, 0.50, 0.36)


def source(name: str, depth: float | None = None) -> Tile:
    """A tile by the name of a procedure, or of an image file with heights. Raises InputError."""
    if name in PROCEDURES:
        make, own = PROCEDURES[name]
        return make(own if depth is None else depth)
    if not Path(name).is_file():
        raise InputError(name, f"neither an image file nor one of {', '.join(PROCEDURES)}")
    return of_heights(read_heights(name), 0.12 if depth is None else depth, name)


def of_heights(heights: Float[np.ndarray, "H W"], depth: float, name: str | PathLike[str] = "heights") -> Tile:
    """A height field, v growing downward as in images; the lowest value lies at −D, the highest at 0. Raises InputError."""
    if not np.isfinite(heights).all() or np.ptp(heights) == 0:
        raise InputError(name, "has no heights: one value everywhere, or one that is not finite")
    rows, columns = (min(n, CELLS) for n in heights.shape)
    grid = _averaged(_averaged(heights.astype(np.float64), rows, 0), columns, 1)
    if np.ptp(grid) <= 1e-9 * np.ptp(heights):
        raise InputError(name, f"has no heights: its pattern is finer than {CELLS} cells, whose means are all equal")
    grid = (grid - grid.min()) / np.ptp(grid)
    v, u = np.meshgrid((np.arange(rows + 1) + 0.5) / rows, (np.arange(columns + 1) + 0.5) / columns, indexing="ij")
    share = np.pad(grid, ((0, 1), (0, 1)), mode="wrap")
    points = np.stack([u, v, (share - 1) * depth], axis=-1).reshape(-1, 3)
    colour = (1 - share)[..., None] * np.array(LOW) + share[..., None] * np.array(HIGH)
    return Tile(points, _grid_faces(rows, columns), colour.reshape(-1, 3), depth, LOW)


def weave(depth: float, yarns: int = 4) -> Tile:
    """Plain weave: yarns of two colours over and under each other, striped like twisted ply."""
    step = 1 / yarns
    flat, wide = 0.26 * depth, 0.42 * step
    # begin where yarns cross h = −D/2, so that both ends have the same slope
    along = np.linspace(0, 1, 16 * yarns + 1) + 0.5 * step
    parts = []
    for k in range(yarns):
        rise = (0.5 * depth - flat) * np.cos(np.pi * yarns * along) * (-1) ** k
        across = np.full_like(along, (k + 0.5) * step)
        warp = np.stack([along + 0.5 * step, across, rise - 0.5 * depth], axis=-1)
        weft = np.stack([across, along + 0.5 * step, -rise - 0.5 * depth], axis=-1)
        for rail, colour in ((warp, (0.55, 0.42, 0.24)), (weft, (0.12, 0.20, 0.34))):
            parts.append(_tube(rail, wide, flat, colour, stripes=5 * yarns))
    return _joined(parts, depth, (0.05, 0.04, 0.04))


def scales(depth: float, rows: int = 4) -> Tile:
    """Rounded plates in rows, each row lying on the one before, as on a fish or a roof."""
    step = 1 / rows
    x, y = np.meshgrid(np.linspace(-1, 1, 13), np.linspace(0, 1, 13), indexing="ij")
    width = np.sqrt(np.clip(1 - (2 * np.clip(y - 0.5, 0, 1)) ** 2, 0, 1))
    bow = 0.18 * depth * (1 - x**2)
    parts = []
    for i in range(rows):
        for j in range(rows):
            u = (i + 0.5 * (j % 2)) * step + 0.56 * step * x * width
            v = (j + 1.9 * y) * step
            h = -depth + 0.80 * depth * y + bow + 0.02 * depth
            tone = 0.75 + 0.25 * np.cos(2.4 * i + 4.1 * j)
            colour = (0.35 + 0.65 * y[..., None]) * tone * np.array((0.20, 0.46, 0.36))
            points = np.stack([u, v, np.minimum(h, 0)], axis=-1)
            parts.append((points.reshape(-1, 3), _grid_faces(12, 12), colour.reshape(-1, 3)))
    return _joined(parts, depth, (0.05, 0.08, 0.07))


def spheres(depth: float, rows: int = 4) -> Tile:
    """Balls on the body, in rows offset by half their spacing."""
    a, b = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13), indexing="ij")
    ball = np.stack([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)], axis=-1).reshape(-1, 3)
    parts = []
    for i in range(rows):
        for j in range(rows):
            radius = depth / 2 * (1 - 0.25 * ((3 * i + 5 * j) % 4 == 1))
            centre = np.array([(i + 0.5 * (j % 2) + 0.25) / rows, (j + 0.5) / rows, radius - depth])
            colour = np.array([(0.60, 0.18, 0.10), (0.58, 0.48, 0.30), (0.20, 0.28, 0.40)][(i + 2 * j) % 3])
            parts.append((centre + radius * ball, _grid_faces(24, 12), np.broadcast_to(colour, ball.shape)))
    return _joined(parts, depth, (0.25, 0.22, 0.20))


def fibres(depth: float, count: int = 260) -> Tile:
    """Short bent fibres, leaning every way, light at their tips."""
    random = np.random.default_rng(7)
    t = np.linspace(0, 1, 7)
    parts = []
    for _ in range(count):
        root, angle, lean = random.random(2), random.uniform(0, 2 * np.pi), random.uniform(0.3, 1.1) * depth
        out = lean * t**1.6
        top = random.uniform(0.75, 0.97) * depth
        rise = -depth + top * np.sin(0.5 * np.pi * t)
        rail = np.stack([root[0] + np.cos(angle) * out, root[1] + np.sin(angle) * out, rise], axis=-1)
        tone = random.uniform(0.7, 1.0)
        points, faces, _ = _tube(rail, 0.05 * depth, 0.05 * depth, (0, 0, 0), sides=5, taper=0.6)
        share = np.repeat(t, 6)[:, None]
        parts.append(
            (points, faces, tone * ((1 - share) * np.array((0.22, 0.14, 0.08)) + share * np.array((0.72, 0.60, 0.40))))
        )
    return _joined(parts, depth, (0.14, 0.10, 0.07))


#: The function that makes each, and its default depth, texture units.
PROCEDURES: dict[str, tuple[Callable[[float], Tile], float]] = {
    "weave": (weave, 0.12),
    "scales": (scales, 0.12),
    "spheres": (spheres, 0.2),
    "fibres": (fibres, 0.2),
}


def _tube(rail, wide: float, flat: float, colour, sides: int = 16, stripes: int = 0, taper: float = 0.0):
    """An elliptical tube about a rail: half-axes `wide` level with the surface, `flat` across; taper: share lost at its end."""
    way = np.gradient(rail, axis=0)
    side = np.cross(way, [0.0, 0, 1])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, way)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    t = np.linspace(0, 1, len(rail))[:, None, None]
    ring = wide * np.cos(angle)[None, :, None] * side[:, None] + flat * np.sin(angle)[None, :, None] * up[:, None]
    points = rail[:, None] + (1 - taper * t) * ring
    stripe = 0.8 + 0.2 * np.cos(angle[None] + 2 * np.pi * stripes * t[..., 0])
    shade = stripe[..., None] * np.array(colour)
    return points.reshape(-1, 3), _grid_faces(len(rail) - 1, sides), shade.reshape(-1, 3)


def _joined(parts, depth: float, body) -> Tile:
    """A tile of several pieces, brought under the bounding surface."""
    first = np.cumsum([0, *(len(p) for p, _, _ in parts[:-1])])
    points = np.concatenate([p for p, _, _ in parts])
    points[:, 2] = np.clip(points[:, 2], -depth, 0)
    faces = np.concatenate([f + n for (_, f, _), n in zip(parts, first, strict=True)])
    return Tile(points, faces, np.concatenate([c for _, _, c in parts]), depth, body)


def _grid_faces(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each cell of a grid with rows + 1 by columns + 1 vertices."""
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1, 1)
    return np.concatenate([first + np.array([0, 1, columns + 2]), first + np.array([0, columns + 2, columns + 1])])


def _averaged(x: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Means over `count` equal shares of an axis."""
    edges = np.linspace(0, x.shape[axis], count + 1)
    total = np.concatenate([np.zeros_like(x.take([0], axis)), x.cumsum(axis)], axis)
    low = np.minimum(np.floor(edges).astype(int), x.shape[axis] - 1)
    share = np.expand_dims(edges - low, tuple(k for k in range(x.ndim) if k != axis))
    at = total.take(low, axis) + share * x.take(low, axis)
    return np.diff(at, axis=axis) * count / x.shape[axis]
