"""Draw the numbers of paths, evenly over the paths of a pixel, however many there will be.

Notation
i           number of a path among its pixel's; a dimension, or a pair of them, has an order of its own
S           Owen's scrambling of a number by a key: each bit is flipped or not, as the key and the bits above it say
(x, y)      Sobol's point i, its bits reversed: x = i, and y = P i for Pascal's triangle P modulo 2, which is a product of five
            factors, one for each bit of a bit's place

The order of the paths in a dimension is S(i): so the first 2^m of them, and each 2^m that follow, are a block of 2^m points of
Sobol's sequence (Burley 2020, "Practical Hash-based Owen Scrambling"). S is of Laine and Karras, with Vegdahl's constants, the
hash Wellons's lowbias32.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Sobol:
    """In place of a sampler of Mitsuba's. pixel: 32 bits of each lane's own; path: i; dimension: how many were drawn."""

    pixel: mi.UInt32
    path: mi.UInt32
    dimension: mi.UInt32

    def next_1d(self):
        """A number in [0, 1)."""
        key, i = self._next()
        return _scrambled(i, key + 1)

    def next_2d(self):
        """A point of [0, 1)²."""
        key, i = self._next()
        return mi.Point2f(_scrambled(i, key + 1), _scrambled(pascal(i), key + 2))

    def sample_count(self) -> int:
        """Paths a pixel by which the differentials of a ray were narrowed."""
        return 1

    def _next(self):
        """The key of another dimension, and the path's number in its order."""
        self.dimension += 1
        key = hash_bits(self.pixel ^ hash_bits(self.dimension))
        return key, dr.brev(_flipped(dr.brev(self.path), key))


def hash_bits(x):
    """Another 32 bits for each."""
    x = (x ^ x >> 16) * 0x7FEB352D
    x = (x ^ x >> 15) * 0x846CA68B
    return x ^ x >> 16


def pascal(i):
    """P i."""
    i = i ^ (i & 0xAAAAAAAA) >> 1
    i = i ^ (i & 0xCCCCCCCC) >> 2
    i = i ^ (i & 0xF0F0F0F0) >> 4
    i = i ^ (i & 0xFF00FF00) >> 8
    return i ^ (i & 0xFFFF0000) >> 16


def _flipped(x, key):
    """S, of reversed bits: those below a bit say whether it is flipped."""
    x = x ^ x * 0x3D20ADEA
    x = (x + key) * (key >> 16 | 1)
    x = x ^ x * 0x05526C56
    return x ^ x * 0x53A22864


def _scrambled(x, key):
    """S of a coordinate whose bits are reversed, as a number in [0, 1)."""
    return mi.Float(dr.brev(_flipped(x, hash_bits(key))) >> 8) * 2**-24
