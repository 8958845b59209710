"""The visual hull: where an object can be, from its masks alone (NumPy).

Notation
hull        cells of a grid whose centres lie inside the masks of all views that see them (Laurentini)
box         centre c and half side a: y = (x − c) / a maps the whole object into [−1, 1]³
agreement   share of a view's masked pixels whose rays meet the hull: 1 if poses, lenses and masks fit each other

A cell is kept where at most MISSES of the views that see its centre show background there; masks are widened by a
pixel and the cell's size, so that no cell of the object is lost.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from mesoshell.neutex.cameras import Photo, photo_rays

CELLS = 64
MISSES = 0.03
#: Side of the first guess, and of the final box, relative to their content.
MARGIN = 1.1
#: Pixels of a view, and points along a ray, for measuring agreement.
PIXELS, PROBES = 400, 192


class Hull(NamedTuple):
    """inside: [x, y, z] cells of the box."""

    centre: Float[np.ndarray, "3"]
    half: float
    inside: Bool[np.ndarray, "n n n"]


def carve(photos: Sequence[Photo], masks: Sequence[Float[np.ndarray, "_h _w"]]) -> Hull | None:
    """The hull and the smallest cube about it, in two passes; None if nothing lies inside all masks."""
    aims = [_aim(photo, mask) for photo, mask in zip(photos, masks, strict=True)]
    origins = np.array([photo.to_world[:3, 3] for photo in photos])
    across = np.eye(3) - np.einsum("vi,vj->vij", [a for a, _ in aims], [a for a, _ in aims])
    centre = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, origins), rcond=None)[0]
    distances = np.linalg.norm(centre - origins, axis=1)
    half = MARGIN * float(np.max(distances * [wide for _, wide in aims]))
    away: list[Any] = [distance_transform_edt(mask < 0.5) for mask in masks]
    for _ in range(2):
        if not half > 0:
            return None
        inside = _kept(photos, away, centre, half)
        if not inside.any():
            return None
        low, high = (f(np.argwhere(inside), axis=0) for f in (np.min, np.max))
        edges = centre - half + np.array([low, high + 1]) * (2 * half / CELLS)
        centre, half = edges.mean(axis=0), MARGIN * float(np.ptp(edges, axis=0).max()) / 2
    inside = _kept(photos, away, centre, half)
    return Hull(centre, half, inside) if inside.any() else None


def agreement(hull: Hull, photo: Photo, mask: Float[np.ndarray, "_h _w"]) -> float:
    """Agreement of one view."""
    rows, columns = np.nonzero(mask >= 0.5)
    some = np.linspace(0, len(rows) - 1, min(PIXELS, len(rows))).astype(int)
    o, d = photo_rays(photo, np.stack([columns[some], rows[some]], axis=1) + 0.5)
    middle = np.linalg.norm(hull.centre - photo.to_world[:3, 3])
    reach = hull.half * 3**0.5
    t = np.linspace(max(0.0, middle - reach), middle + reach, PROBES)
    return float(holds(hull, o[:, None] + d[:, None] * t[:, None]).any(axis=1).mean())


def holds(hull: Hull, x: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Whether points lie in cells of the hull."""
    cell = np.floor(((x - hull.centre) / hull.half + 1) * (CELLS / 2)).astype(int)
    held = ((cell >= 0) & (cell < CELLS)).all(axis=-1)
    i, j, k = np.moveaxis(np.clip(cell, 0, CELLS - 1), -1, 0)
    return held & hull.inside[i, j, k]


def left_out(hull: Hull, centre: Float[np.ndarray, "3"], half: float) -> float:
    """Share of the hull's cells that lie outside of a box."""
    x = hull.centre + hull.half * ((np.argwhere(hull.inside) + 0.5) * (2 / CELLS) - 1)
    return float((np.abs(x - centre) > half).any(axis=1).mean())


def _aim(photo: Photo, mask: Float[np.ndarray, "_h _w"]) -> tuple[Float[np.ndarray, "3"], float]:
    """The direction to the middle of a view's mask, and the tangent of the angle from there to its farthest corner."""
    rows, columns = np.nonzero(mask >= 0.5)
    edge = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]], float)
    corners = np.array([[x, y] for x in edge[:, 0] for y in edge[:, 1]])
    _, d = photo_rays(photo, np.vstack([edge.mean(axis=0), corners]))
    cosine = np.clip(d[1:] @ d[0], 1e-3, 1)
    return d[0], float(np.max(np.sqrt(1 - cosine**2) / cosine))


def _kept(
    photos: Sequence[Photo], away: list[np.ndarray], centre: np.ndarray, half: float
) -> Bool[np.ndarray, "n n n"]:
    axis = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    x = centre + half * grid
    views, missed = np.zeros(len(x), np.int32), np.zeros(len(x), np.int32)
    for photo, far in zip(photos, away, strict=True):
        fx, fy, cx, cy = photo.lens
        local = (x - photo.to_world[:3, 3]) @ photo.to_world[:3, :3]
        depth = -local[:, 2]
        ahead = depth > 1e-9
        depth = np.where(ahead, depth, 1.0)
        u, v = cx + fx * local[:, 0] / depth, cy - fy * local[:, 1] / depth
        h, w = far.shape
        view = ahead & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        i, j = np.where(view, v, 0).astype(int), np.where(view, u, 0).astype(int)
        width = fx * half / CELLS / depth  # half a cell's side, pixels
        views += view
        missed += view & (far[i, j] > 1 + width * 3**0.5)
    return ((views > 0) & (missed <= MISSES * views)).reshape(CELLS, CELLS, CELLS)
