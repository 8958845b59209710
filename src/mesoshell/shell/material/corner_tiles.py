"""Where on the torus of corner tiles a patch of the plane is looked up (io/corner_tiles).

Notation
(i, j)      a patch of the plane, and its first corner
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt32

from mesoshell.io.corner_tiles import FACTORS, LAST, ROUNDS, Colours, places
from mesoshell.typing import Array, Int, Vec2

#: Whole patches along u and v, modulo 2³².
Origin = UInt32[Array, "2"]


def as_origin(patches: tuple[int, int]) -> Origin:
    """An origin (u, v) of whole patches."""
    return jnp.asarray(np.array(patches, np.int64).astype(np.uint32))


def tile_place(colours: Colours, origin: Origin | None, patch: Int[Array, "2"]) -> Int[Array, "2"]:
    """The patch of the torus that a patch of the plane shows. origin: (i, j) of the plane at (0, 0)."""
    i, j = patch.astype(jnp.uint32) if origin is None else patch.astype(jnp.uint32) + origin
    corners = ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))
    tile = sum((_colour(*c) << k for k, c in enumerate(corners)), start=jnp.uint32(0))
    return jnp.asarray(places(colours))[tile]


def on_torus(colours: Colours, origin: Origin | None, uv: Vec2) -> Vec2:
    """(u, v) of the plane on the torus, both in patches."""
    first = jnp.floor(uv)
    return tile_place(colours, origin, first.astype(jnp.int32)).astype(uv.dtype) + (uv - first)


def _colour(i: Array, j: Array) -> Array:
    h = i * jnp.uint32(FACTORS[0]) ^ j * jnp.uint32(FACTORS[1])
    for factor, shift in ROUNDS:
        h = (h ^ (h >> shift)) * jnp.uint32(factor)
    return (h ^ (h >> LAST)) & 1
