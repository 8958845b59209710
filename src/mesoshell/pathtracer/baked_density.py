"""σ of a material's finest level in a grid, read in place of the network: in a small part of its time.

Notation
S           columns of the grid along a texel of the texture's finest level; column i is (i + ½) / S texels from the border
K           rows along the height, at (k + ½) / K
α           appearance parameters, normalised; one that differs over a surface, or between shells, is baked at 0 and 1, the
            others at their one value

σ is linear between columns, rows and values of α. The network has edges that are sharper than a texel: with two columns a texel
σ of grass is off by half as much as with one. (Interpolating what softplus takes keeps edges sharp, and loses a quarter of all
density: blades are thin.)

A grid that takes a while to make is kept in the cache, by a hash of all that it depends on; what was not used for longest goes
when all are more than MAX_BYTES.
"""

import hashlib
import itertools
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell import __version__
from mesoshell.io.cache import cache_folder
from mesoshell.io.kept_arrays import keep_arrays, read_arrays
from mesoshell.pathtracer.levels import texel
from mesoshell.render.effects import MAX_BAKED

K = 64
#: Numbers that are made at once; those of grids that are kept, at least; bytes of all that are kept, at most.
CHUNK, MIN_KEPT, MAX_BYTES = 2**22, 2**20, 2**30


def grid_shape(texture: tuple[int, ...], varying: int, most: int = MAX_BAKED) -> tuple[int, ...]:
    """Shape of a grid, (2, …, S V, S U, K), with S = 2 where that holds at most so many numbers. texture: shape of its finest
    level, (V, U, C); varying: parameters that do."""
    shapes = [(*[2] * varying, s * texture[0], s * texture[1], K) for s in (2, 1)]
    return next((s for s in shapes if math.prod(s) <= most), shapes[-1])


class BakedDensity:
    """The grid of a material. alpha: a number, or None for a parameter that varies; most: numbers that it may hold."""

    def __init__(self, material, alpha: list[float | None], most: int = MAX_BAKED):
        self.material, self.varying = material, [i for i, a in enumerate(alpha) if a is None]
        self.shape = grid_shape(material.plane.shapes[0], len(self.varying), most)
        self.fine = self.shape[-2] // material.plane.shapes[0][1]
        count = math.prod(self.shape)
        key = hashlib.sha256(f"{__version__} {material.digest} {alpha} {self.shape}".encode()).hexdigest()[:32]
        entry = cache_folder("densities") / f"{key}.npz"
        kept = read_arrays(entry, ["sigma"]) if count >= MIN_KEPT else None
        numbers = self._made(alpha, count) if kept is None else kept["sigma"]
        if kept is None and count >= MIN_KEPT:
            keep_arrays(entry, {"sigma": numbers}, MAX_BYTES)
        self.numbers = mi.Float16(numbers)

    def _made(self, alpha: list[float | None], count: int) -> np.ndarray:
        numbers = np.empty(count, np.float16)
        for first in range(0, count, CHUNK):
            part = numbers[first : first + CHUNK]
            part[:] = np.minimum(self._by_network(alpha, first, len(part)), np.finfo(np.float16).max)
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
