"""Feature pyramids and networks of materials on the device (texture/mip, nets/mlp, in Dr.Jit).

Texels are stored once, all levels in one array. Networks are evaluated by cooperative vectors in the integrator's own loop: a
network within a virtual call is 20 times slower.
"""

from typing import Any

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.io.level_arrays import flatten

#: Most half-precision numbers that are widened to float32. More are read by fours, as integers of 64 bits: a picture takes up
#: to a tenth longer; a quarter longer where a row's length is no multiple of 4, and they are read alone.
MAX_WIDENED = 2**26
#: An array of Dr.Jit's has fewer entries.
MAX_ENTRIES = 2**32


class Levels:
    """Arrays of several levels, one after the other. wide: rows of the last axis are read whole; else single numbers. Raises
    InputError for more numbers than Dr.Jit can index."""

    def __init__(self, levels: list[np.ndarray], wide: bool = True):
        half = all(x.dtype == np.float16 for x in levels) and sum(x.size for x in levels) > MAX_WIDENED
        self._vector: Any
        self.rows: Any
        self.scalar, self._vector = (mi.Float16, mi.ArrayXf16) if half else (mi.Float, mi.ArrayXf)
        self.width = levels[0].shape[-1] if wide else 1
        numbers = flatten(levels).astype(np.float16 if half else np.float32, copy=False)
        self._fours = half and self.width % 4 == 0
        if len(numbers) >= (4 if self._fours else 1) * MAX_ENTRIES:
            limit = "is too large for Mitsuba: of half precision and a multiple of 4 channels it may have 2³⁴ numbers, else 2³²"
            raise InputError(Argument("material"), limit)
        if self._fours:
            self.rows, self._vector = mi.UInt64(numbers.view(np.uint64)), mi.ArrayXu64
        else:
            self.rows = self.scalar(numbers)
        self.shapes = [x.shape for x in levels]
        self.sizes = [mi.UInt32([s[k] for s in self.shapes]) for k in range(levels[0].ndim)]
        self.offset = mi.UInt32(np.cumsum([0, *(x.size // self.width for x in levels[:-1])]).astype(np.uint32))

    def size(self, l):
        """Texels of a level along the first two axes."""
        return [dr.gather(mi.UInt32, self.sizes[k], l) for k in range(2)]

    def bilinear(self, x, y, l, wraps):
        """Bilinear row at (x, y) of a level, in texels from the centre of the first; wraps: around edges, or else clamped."""
        height, width = self.size(l)
        offset = dr.gather(mi.UInt32, self.offset, l)
        i, j = dr.floor(x), dr.floor(y)
        fx, fy = x - i, y - j
        columns, lines = ([texel(k, n, wraps) for k in (m, m + 1)] for m, n in ((i, width), (j, height)))
        total = [mi.Float(0)] * self.width
        for line, wy in zip(lines, (1 - fy, fy), strict=True):
            for column, wx in zip(columns, (1 - fx, fx), strict=True):
                row, weight = self.row(offset + line * width + column), wx * wy
                total = [s + weight * r for s, r in zip(total, row, strict=True)]
        return total

    def linear(self, h, l, first=None):
        """Row at h in [0, 1] of a level whose second axis is h, linear between rows and clamped; first: on the first axis."""
        rows = dr.gather(mi.UInt32, self.sizes[1], l)
        offset = dr.gather(mi.UInt32, self.offset, l)
        if first is not None:
            offset += first * rows
        z = dr.clip(h * mi.Float(rows) - 0.5, 0, mi.Float(rows) - 1)
        i = dr.floor(z)
        f = z - i
        low = self.row(offset + mi.UInt32(i))
        high = self.row(offset + dr.minimum(mi.UInt32(i) + 1, rows - 1))
        return [(1 - f) * a + f * b for a, b in zip(low, high, strict=True)]

    def row(self, index):
        """One row as a list of float32."""
        width = self.width // 4 if self._fours else self.width
        numbers = dr.gather(self._vector, self.rows, index, shape=(width, dr.width(index)))
        if self._fours:
            return [_half(mi.UInt32(numbers[c // 4] >> 16 * (c % 4))) for c in range(self.width)]
        return [mi.Float(numbers[c]) for c in range(self.width)]


def texel(i, n, wraps):
    """Index of texel i of n along an axis."""
    size = mi.Float(n)
    if wraps:
        i = dr.select(i < 0, i + size, dr.select(i >= size, i - size, i))
    return mi.UInt32(dr.clip(i, 0, size - 1))


def _half(x):
    """The finite number of half precision that the lower 16 bits are, as float32: exact. A subnormal one is made from
    its mantissa, for Dr.Jit flushes subnormal float32 to zero."""
    bits: Any = dr.reinterpret_array(mi.Float, (x & 0x7FFF) << 13)
    normal = bits * 2.0**112
    size = dr.select((x & 0x7C00) != 0, normal, mi.Float(x & 0x3FF) * 2.0**-24)
    return dr.select((x & 0x8000) != 0, -size, size)


def network(a: dict[str, np.ndarray], hidden: str, last: str) -> tuple[list[Any], Any]:
    """Layers as (weight, bias) views of one packed buffer: the hidden ones, and the last."""
    names = [*(f"{hidden}/{i}" for i in range(count(a, hidden + "/{}/kernel"))), last]
    parts = []
    for name in names:
        parts.append(mi.TensorXf(a[f"{name}/kernel"].T.astype(np.float32).copy()))
        parts.append(mi.TensorXf(a[f"{name}/bias"].astype(np.float32)))
    views = nn.pack(*parts, layout="inference")
    layers = list(zip(views[::2], views[1::2], strict=True))
    return layers[:-1], layers[-1]


def count(a: dict[str, np.ndarray], key: str) -> int:
    """How many arrays of a numbered key, such as `features/{}`, there are."""
    n = 0
    while key.format(n) in a:
        n += 1
    return n


def level_of(radius, density: float, last: int):
    """Level at which a texel is as wide as the footprint's ±1 standard deviation (texture/mip)."""
    width = 2 * radius * density
    return dr.log2(dr.clip(dr.select(dr.isnan(width), 1, width), 1, 2.0**last))


def between_levels(level, last: int, at):
    """at(l), a list, blended between the levels below and above; level: None is the finest alone."""
    if level is None:
        return at(mi.UInt32(0))
    lower = dr.floor(level)
    share, first = level - lower, mi.UInt32(lower)
    return [(1 - share) * a + share * b for a, b in zip(at(first), at(dr.minimum(first + 1, last)), strict=True)]


def softplus(x):
    """log(1 + eˣ) = max(x, 0) + 2 artanh(e / (2 + e)), e = exp(−|x|): no overflow, and small values keep their precision."""
    e = dr.exp(-dr.abs(x))
    z = e / (2 + e)
    series = mi.Float(0)
    for k in range(13, 0, -2):  # z is at most 1/3
        series = dr.fma(series, z * z, 1 / k)
    return dr.maximum(x, 0) + 2 * z * series
