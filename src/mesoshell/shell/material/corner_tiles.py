"""Where on the torus of corner tiles a place of the plane is looked up (io/corner_tiles).

Notation
(u, v)      coordinates in patches
(i, j)      a corner of the patch lattice
"""

import jax.numpy as jnp

from mesoshell.io.corner_tiles import FACTORS, LAST, ROUNDS, Colours, places
from mesoshell.typing import Array, Vec2


def on_torus(colours: Colours, origin: tuple[int, int], uv: Vec2) -> Vec2:
    """(u, v) on the torus, in patches. origin: (i, j) of the plane at (0, 0)."""
    first = jnp.floor(uv)
    i, j = (x.astype(jnp.int32).astype(jnp.uint32) + jnp.uint32(o) for x, o in zip(first, origin, strict=True))
    corners = ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))
    tile = sum((_colour(*c) << k for k, c in enumerate(corners)), start=jnp.uint32(0))
    return jnp.asarray(places(colours), uv.dtype)[tile] + (uv - first)


def _colour(i: Array, j: Array) -> Array:
    h = i * jnp.uint32(FACTORS[0]) ^ j * jnp.uint32(FACTORS[1])
    for factor, shift in ROUNDS:
        h = (h ^ (h >> shift)) * jnp.uint32(factor)
    return (h ^ (h >> LAST)) & 1
