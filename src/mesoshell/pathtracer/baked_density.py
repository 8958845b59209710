"""σ of a material's finest level in a grid (io/density_grid), read in place of the network: in a small part of its time."""

import itertools
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.io.density_grid import K, grid_shape, in_half, kept_grid
from mesoshell.pathtracer.levels import texel

#: Numbers that are made at once.
CHUNK = 2**22


class BakedDensity:
    """The grid of a material. alpha: a number, or None for a parameter that varies; most: numbers that it may hold."""

    def __init__(self, material, alpha: list[float | None], most: int):
        self.material, self.varying = material, [i for i, a in enumerate(alpha) if a is None]
        self.shape = grid_shape(material.plane.shapes[0], len(self.varying), most)
        self.fine = self.shape[-2] // material.plane.shapes[0][1]
        self.numbers = mi.Float16(kept_grid((material.digest, alpha), self.shape, lambda: self._made(alpha)))

    def _made(self, alpha: list[float | None]) -> np.ndarray:
        numbers = np.empty(math.prod(self.shape), np.float16)
        for first in range(0, len(numbers), CHUNK):
            part = numbers[first : first + CHUNK]
            part[:] = in_half(self._by_network(alpha, first, len(part)))
        return numbers

    def _by_network(self, alpha: list[float | None], first: int, count: int) -> np.ndarray:
        """σ of so many places of the grid, from the first."""
        rest, places = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, count), []
        for size in reversed(self.shape):
            places.insert(0, mi.Float(rest % size))
            rest //= size
        y, x, h = ((place + 0.5) / size for place, size in zip(places[-3:], (self.fine, self.fine, K), strict=True))
        values: list[Any] = [None if a is None else mi.Float(a) for a in alpha]
        for i, value in zip(self.varying, places, strict=False):
            values[i] = value
        return np.array(self.material.density_of(self.material.inputs_on_texture(x - 0.5, y - 0.5, h, values))[0])

    def at(self, xi, alpha):
        """σ at ξ. alpha: a list of floats."""
        x, y = ((c + 0.5) * self.fine - 0.5 for c in self.material.texels(xi, mi.UInt32(0)))
        z, wraps = dr.clip(xi.z * K - 0.5, 0, K - 1), self.material.wraps
        ends = [([mi.UInt32(0), mi.UInt32(1)], dr.clip(alpha[i], 0, 1)) for i in self.varying]
        for place, size, around in zip((y, x, z), self.shape[-3:], (wraps, wraps, False), strict=True):
            below = dr.floor(place)
            ends.append(([texel(below + k, size, around) for k in (0, 1)], place - below))
        total = mi.Float(0)
        for corner in itertools.product((0, 1), repeat=len(ends)):
            index, weight = mi.UInt32(0), mi.Float(1)
            for side, size, (places, share) in zip(corner, self.shape, ends, strict=True):
                index, weight = index * size + places[side], weight * (share if side else 1 - share)
            total += weight * mi.Float(dr.gather(mi.Float16, self.numbers, index))
        return total
