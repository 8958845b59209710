"""How evenly a surface is mapped to its texture (NumPy only).

Notation
y, u        of each pixel of a view: where its ray meets the surface, and the unit vector that this point maps to
J           area in the texture over area on the surface, of a triangle of neighbouring pixels
distortion  standard deviation of ln J over the surface, by area: 0 if all parts have the same share of the texture; J below
            MIN_JACOBIAN of its mean counts as MIN_JACOBIAN
folded      share of the surface whose triangles have the opposite orientation in the texture to most
used        share of the texture, by solid angle, that some pixel maps to, in CELLS² cells a cube face
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

MIN_JACOBIAN, CELLS = 1e-3, 16
#: A triangle with a side so many times its view's median spans a gap between two parts of the surface.
GAP = 4.0


class Chart(NamedTuple):
    """The three numbers above."""

    distortion: float
    folded: float
    used: float


def chart(
    y: Sequence[Float[np.ndarray, "_h _w 3"]],
    u: Sequence[Float[np.ndarray, "_h _w 3"]],
    hit: Sequence[Bool[np.ndarray, "_h _w"]],
) -> Chart:
    """The scores over all views. Raises ValueError if no view has a whole triangle."""
    areas, ratios = [], []
    for y_, u_, hit_ in zip(y, u, hit, strict=True):
        for corner in (((0, 0), (0, 1), (1, 0)), ((1, 1), (1, 0), (0, 1))):
            a, b = _area(y_, u_, hit_, corner)
            areas.append(a)
            ratios.append(b)
    area, signed = np.concatenate(areas), np.concatenate(ratios)
    if not area.sum() > 0:
        raise ValueError("no view shows a piece of surface")
    most = np.sign(np.sum(np.sign(signed) * area)) or 1.0
    j = np.abs(signed)
    log = np.log(np.maximum(j, max(MIN_JACOBIAN * np.average(j, weights=area), np.finfo(np.float64).tiny)))
    mean = np.average(log, weights=area)
    cells = np.unique(np.concatenate([_cells(u_[hit_]) for u_, hit_ in zip(u, hit, strict=True)]))
    return Chart(
        float(np.sqrt(np.average((log - mean) ** 2, weights=area))),
        float(area[np.sign(signed) != most].sum() / area.sum()),
        float(_solid(cells).sum()),
    )


def _area(y: np.ndarray, u: np.ndarray, hit: np.ndarray, corner: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Area on the surface of each triangle of a view, and area in the texture over it, negative where it is turned over."""
    h, w = hit.shape

    def at(x: np.ndarray) -> list[np.ndarray]:
        return [x[i : h - 1 + i, j : w - 1 + j] for i, j in corner]

    a, b, c = at(y)
    whole = np.logical_and.reduce(at(hit))
    longest = np.maximum(np.linalg.norm(b - a, axis=-1), np.linalg.norm(c - a, axis=-1))
    if whole.any():
        whole &= longest < GAP * np.median(longest[whole])
    p, q, r = at(u)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2
    there = np.einsum("hwc,hwc->hw", np.cross(q - p, r - p), p) / 2
    keep = whole & (area > 0)
    return area[keep], there[keep] / area[keep]


def _cells(u: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "n"]:
    axis = np.abs(u).argmax(axis=1)
    rows = np.arange(len(u))
    ahead = u[rows, axis]
    rest = np.stack([u[rows, (axis + 1) % 3], u[rows, (axis + 2) % 3]], axis=1) / np.abs(ahead)[:, None]
    cell = np.clip(np.floor((rest + 1) / 2 * CELLS).astype(int), 0, CELLS - 1)
    return ((2 * axis + (ahead < 0)) * CELLS + cell[:, 0]) * CELLS + cell[:, 1]


def _solid(cells: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Share of the sphere that each cell covers."""

    def corner(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.arctan(x * y / np.sqrt(1 + x * x + y * y))

    i, j = cells // CELLS % CELLS, cells % CELLS
    x0, x1, y0, y1 = (2 * k / CELLS - 1 for k in (i, i + 1, j, j + 1))
    return (corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)) / (4 * np.pi)
