"""Filtered F(h) of a material: one for a whole texture, or one at each of its nodes (shell/material/field in Dr.Jit).

Notation
F(h)        height feature, C numbers, between rows and between levels
node        a corner of patches; those of a texture with edges, which begins at `origin`, lie at (v, u) = 0, 1, 2, …
σ_h         standard deviation of the filter along the height

Between four nodes F(h) is bilinear, beyond the outermost it is clamped. Without nodes, none of this is compiled.
"""

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.pathtracer.levels import Levels, between_levels, count, level_of


class Heights:
    """The arrays height/…, or heights/… if they exist, on the device. origin: (u, v) of the first node."""

    def __init__(self, arrays: dict[str, np.ndarray], origin: tuple[int, int]):
        name = "heights" if "heights/0" in arrays else "height"
        levels = [arrays[f"{name}/{i}"] for i in range(count(arrays, "height/{}"))]
        self.nodes: tuple[int, ...] | None = levels[0].shape[:2] if name == "heights" else None
        self.origin, self.rows = origin, levels[0].shape[-2]
        self.levels = Levels([x.reshape(-1, *x.shape[-2:]) for x in levels])  # (node, row, C)

    def at(self, xi, deviation):
        """F(h) at ξ, a list of floats. deviation: σ_h; None is the finest level."""
        last = len(self.levels.shapes) - 1
        level = None if deviation is None else level_of(deviation, float(self.rows), last)
        if self.nodes is None:
            return between_levels(level, last, lambda l: self._linear(xi.z, l))
        around = self._around(xi, *self.nodes)
        return between_levels(level, last, lambda l: self._between(around, xi.z, l))

    def _around(self, xi, along_v: int, along_u: int):
        """The four nodes about ξ, and the share of each."""
        u, v = xi.x - self.origin[0], xi.y - self.origin[1]
        i, j = (dr.clip(dr.floor(x), 0, n - 2) for x, n in ((u, along_u), (v, along_v)))
        fu, fv = (dr.clip(x - k, 0, 1) for x, k in ((u, i), (v, j)))
        first = mi.UInt32(j) * along_u + mi.UInt32(i)
        shares = (1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu
        return list(zip((first, first + 1, first + along_u, first + along_u + 1), shares, strict=True))

    def _between(self, around, h, l):
        total = [mi.Float(0)] * self.levels.width
        for node, share in around:
            total = [t + share * x for t, x in zip(total, self._linear(h, l, node), strict=True)]
        return total

    def _linear(self, h, l, node=0):
        """F(h) of a node at a level."""
        return self.levels.linear(h, l, None if self.nodes is None else node)
