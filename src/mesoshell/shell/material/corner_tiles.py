"""Where on the torus of corner tiles a patch of the plane is looked up (io/corner_tiles).

Notation
(i, j)      a patch of the plane, and its first corner
"""

import jax.numpy as jnp

from mesoshell.io.corner_tiles import FACTORS, LAST, ROUNDS, Colours, places
from mesoshell.typing import Array, Int, Vec2


def tile_place(colours: Colours, origin: tuple[int, int], patch: Int[Array, "2"]) -> Int[Array, "2"]:
    """The patch of the torus that a patch of the plane shows. origin: (i, j) of the plane at (0, 0)."""
    i, j = (patch[k].astype(jnp.uint32) + jnp.uint32(origin[k]) for k in (0, 1))
    corners = ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))
    tile = sum((_colour(*c) << k for k, c in enumerate(corners)), start=jnp.uint32(0))
    return jnp.asarray(places(colours))[tile]


def on_torus(colours: Colours, origin: tuple[int, int], uv: Vec2) -> Vec2:
    """(u, v) of the plane on the torus, both in patches."""
    first = jnp.floor(uv)
    return tile_place(colours, origin, first.astype(jnp.int32)).astype(uv.dtype) + (uv - first)


def _colour(i: Array, j: Array) -> Array:
    h = i * jnp.uint32(FACTORS[0]) ^ j * jnp.uint32(FACTORS[1])
    for factor, shift in ROUNDS:
        h = (h ^ (h >> shift)) * jnp.uint32(factor)
    return (h ^ (h >> LAST)) & 1
