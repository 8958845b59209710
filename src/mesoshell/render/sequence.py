"""Numbers that rays draw: even over the rays of a pixel, and unlike those of the pixels around it.

Notation
n           steps of a ray along the sequences of its pixel, 0 in their middle
φ_d         root of x^(d+1) = x + 1: multiples of (1/φ_d, 1/φ_d², …, 1/φ_d^d) modulo 1 cover [0, 1)^d evenly, however many there
            are (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"). φ_1 is the golden ratio
r           where a pixel's sequences are at n = 0, by dimension: multiples of irrational steps along the picture's axes. So
            neighbours' errors differ, which the eye averages, and all pixels together cover all dimensions evenly
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Num

#: 1/φ_1; then 1/φ_d, 1/φ_d², … for two and three dimensions.
GOLDEN = 0.6180339887498949
PLANE = 1.324717957244746 ** -np.arange(1.0, 3.0)
SPACE = 1.2207440846057596 ** -np.arange(1.0, 4.0)
#: Steps of r from column to column and from row to row; those of the first and the last dimension, whose errors are large, are
#: of φ_2, which lay out the picture best.
AXES = np.stack([PLANE, np.sqrt([2, 3]), np.sqrt([5, 7]), PLANE[::-1]], axis=1)


class Draws(NamedTuple):
    """What rays draw numbers from."""

    rotation: Float[np.ndarray, "R 4"]
    steps: float

    def numbers(self) -> Float[np.ndarray, "R"]:
        """One in [0, 1) of each ray. Its steps are of √2: independent of those of samples along rays, golden or equal."""
        return (self.rotation[:, 3] + self.steps * 2**0.5) % 1.0

    def triples(self, count: int) -> Float[np.ndarray, "count R 3"]:
        """`count` points of [0, 1)³ of each ray."""
        i = self.steps * count + np.arange(count)
        return (self.rotation[:, :3] + i[:, None, None] * SPACE) % 1.0


def draws_at(pixels: Num[np.ndarray, "R 2"], steps: float) -> Draws:
    """Of rays so many steps along the sequences of their pixels, which are given by column and row."""
    return Draws(pixels @ AXES % 1.0, steps)
