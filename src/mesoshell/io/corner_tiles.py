"""Corner tiles: how a texture of 4 × 4 patches covers a plane without repeating itself (NumPy only; the same in all engines).

Notation
    corner    a point of the patch lattice, whole coordinates (i, j) along (u, v); its colour is 0 or 1, by a hash of (i, j)
    tile      a patch by the colours of its corners (i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1): bits 0 to 3 of its number
    torus     of SIDE × SIDE patches, on which each of the 16 tiles lies once; colours[j][i] is that of its corner (i, j)

A texel of the plane is read at the same place of its patch's tile on the torus. Tiles that share an edge have the same pieces
there, so neighbours fit. After Lagae and Dutré 2006, "An Alternative for Wang Tiles: Colored Edges versus Colored Corners".
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

#: Patches along a side of the torus.
SIDE = 4
#: Rounds of the hash of i and j combined, (factor, shift): x ← (x ^ x >> shift) · factor.
ROUNDS = ((0x2C1B3C6D, 15), (0x297A2D39, 12))
#: Factors of i and j in the hash; the shift after the last round.
FACTORS, LAST = (0x9E3779B1, 0x85EBCA77), 15
#: Patches between the origins of two seeds on the plane.
_APART = 2**15

Colours = Sequence[Sequence[int]]


def is_torus(colours: Any) -> bool:
    """Whether these colours make a torus that holds each tile once."""
    if not (isinstance(colours, list | tuple) and len(colours) == SIDE):
        return False
    if not all(isinstance(row, list | tuple) and len(row) == SIDE for row in colours):
        return False
    if not all(type(c) is int and c in (0, 1) for row in colours for c in row):
        return False
    return len({_number(colours, i, j) for i in range(SIDE) for j in range(SIDE)}) == SIDE**2


def places(colours: Colours) -> Int[np.ndarray, "16 2"]:
    """Where on the torus each tile lies: (i, j)."""
    positions = np.zeros((SIDE**2, 2), np.int32)
    for i in range(SIDE):
        for j in range(SIDE):
            positions[_number(colours, i, j)] = i, j
    return positions


def _number(colours: Colours, i: int, j: int) -> int:
    corners = ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))
    return sum(colours[b % SIDE][a % SIDE] << k for k, (a, b) in enumerate(corners))


def seed_origin(seed: int) -> tuple[int, int]:
    """The (i, j) of the plane at which a seed's texture begins."""
    return (seed % 2**16 * _APART, seed // 2**16 % 2**16 * _APART)
