"""Which patches of a chart one picture shows: what of a texture must be grown for it.

Notation
a, b        (u, v) where a ray enters and leaves a prism, patches                                             (I, 2)
s           how far apart rays are there, a pixel's width at least, world; about RAYS are traced, whatever the picture's size
p           patches that a world length spans on a prism's face, at most
r           how far what a picture looks up lies from a ray, patches: REACH + p s. Where the shell is lower than s, next to each
            other rays leave gaps along the ground, of (s − height) / sine of their slope: these too

A ray is followed to the surface under the shell, as if nothing grew there. What shows through gaps that are narrower than rays
are apart may be missed: of 60 000 rays at random a picture, a head and a cow from 48 sides, at most one (2026-11-30).
"""

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.mesh import Mesh
from mesoshell.render.camera import Camera, rays
from mesoshell.shell.geometry.chart import REACH, Seen, in_boxes
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.join import join_shells
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render.renderer import tables

#: Rays that are traced, about, and at a time; patches between the cuts of what a ray passes.
RAYS, BATCH, PIECE = 1 << 16, 1 << 15, 1.0
#: Share by which a shell narrows its faces, about; least sine of a slope; farthest reach, patches.
STRETCH, FLATTEST, FARTHEST = 1.5, 0.02, 1e6


class Boxes(NamedTuple):
    """Boxes in the chart that rays pass, each in a prism."""

    prism: Int[np.ndarray, "N"]
    low: Float[np.ndarray, "N 2"]
    high: Float[np.ndarray, "N 2"]


def patches_seen(camera: Camera, grown: tuple[tuple[Mesh, Shell], ...], objects: tuple[Mesh, ...]) -> list[Seen]:
    """Which patches a camera sees of each mesh that something grows on. Rays are traced once, when first asked."""
    mesh, shell = join_shells(grown)
    boxes = cache(lambda: _boxes(camera, tables(shell, mesh, objects)[0], shell))
    ends = np.cumsum([0, *(len(own.faces) for _, own in grown)]).tolist()

    def seen(first: int, end: int) -> Seen:
        def among(origin: tuple[int, int], patches: tuple[int, int]) -> Bool[np.ndarray, "V U"]:
            prism, low, high = boxes()
            own = (prism >= first) & (prism < end)
            return in_boxes(low[own], high[own], origin, patches)

        return among

    return [seen(*pair) for pair in pairwise(ends)]


def _boxes(camera: Camera, boundary: Boundary, shell: Shell) -> Boxes:
    stride = (camera.width * camera.height / RAYS) ** 0.5
    sides = (np.arange(0.5, np.ceil(n / stride)) * stride for n in (camera.width, camera.height))
    grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    across, normal = _span_of(shell)
    height = np.linalg.norm(shell.offset.astype(np.float64), axis=1)[shell.faces].min(axis=1)
    parts = []
    for part in np.split(grid, range(BATCH, len(grid), BATCH)):
        o, d = rays(camera, part)
        i = boundary.trace(o, d).intervals
        uv = shell.uv.astype(np.float64)[i.prism]
        a, b = (
            uv[:, 2] + x[:, :1] * (uv[:, 0] - uv[:, 2]) + x[:, 1:] * (uv[:, 1] - uv[:, 2])
            for x in (i.bary0.astype(np.float64), i.bary1.astype(np.float64))
        )
        sine = np.maximum(np.abs(np.einsum("ni,ni->n", d[i.ray], normal[i.prism])), FLATTEST)
        s, p = camera.spread * max(stride, 1.0) * i.t1, STRETCH * across[i.prism]
        reach = REACH + p * (s + np.maximum(s - height[i.prism], 0) / sine)
        parts.append(_cut(i.prism, a, b, np.minimum(reach, FARTHEST)))
    return Boxes(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _cut(prism: np.ndarray, a: np.ndarray, b: np.ndarray, reach: np.ndarray) -> Boxes:
    """Boxes about the way from a to b, cut where it is long."""
    count = np.ceil(np.abs(b - a).max(axis=1, initial=0) / PIECE).clip(1, 4096).astype(int)
    row = np.repeat(np.arange(len(count)), count)
    k = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    begin, end = (a[row] + (b - a)[row] * (at / count[row])[:, None] for at in (k, k + 1))
    r = reach[row, None]
    return Boxes(prism[row], np.minimum(begin, end) - r, np.maximum(begin, end) + r)


def _span_of(shell: Shell) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P 3"]]:
    """p, and unit normals."""
    corner, uv = shell.base.astype(np.float64)[shell.faces], shell.uv.astype(np.float64)
    e, f = corner[:, 1:] - corner[:, :1], uv[:, 1:] - uv[:, :1]
    normal = np.cross(e[:, 0], e[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        # rows of f are steps in the chart for those of e: squares of the singular values of the map from e to f
        inverse = np.linalg.pinv(np.einsum("pij,pkj->pik", e, e))
        square = np.einsum("pij,pik,pkl->pjl", f, inverse, f)
    most = np.linalg.eigvalsh(square)[:, -1]
    return np.sqrt(np.maximum(np.nan_to_num(most), 0)), np.nan_to_num(normal)
