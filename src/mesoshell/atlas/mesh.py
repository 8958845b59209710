"""The surface that the texture is wrapped on, as triangles.

Alphabet
cube        six squares of n × n quads, the cubemap's: no triangle crosses a side of the texture's image
lattice     places of the cube's corners of quads in whole numbers, 0 to n on each axis; squares share those on an edge
vertices    F_uv⁻¹ of their directions, one for each corner of a square; those of one lattice point are the same number

It is closed wherever F_uv⁻¹ is: everywhere, since it is continuous on the sphere. Texture coordinates stay half a pixel inside
their square, so that none of another's is mixed in.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from mesoshell.atlas.field import Field, to_surface
from mesoshell.atlas.layout import on_faces


class Wrapped(NamedTuple):
    """uv: of the cubemap's image, v upward; u: directions of the vertices."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "T 3"]
    uv: Float[np.ndarray, "V 2"]
    u: Float[np.ndarray, "V 3"]


def wrapped(field: Field, n: int, side: int) -> Wrapped:
    """In the box's units; n: quads a side of the cube; side: pixels a side of the cubemap's squares."""
    grid = np.linspace(0, 1, n + 1)
    y, x = np.meshgrid(grid, grid, indexing="ij")
    square = np.tile(np.stack([x, y], axis=-1).reshape(-1, 2), (6, 1))
    face = np.repeat(np.arange(6), (n + 1) ** 2)
    lattice = np.round((on_faces(square, face) + 1) / 2 * n).astype(int)
    one, of = np.unique(lattice, axis=0, return_inverse=True)
    # equal angles, not equal lengths: triangles of one size on the sphere
    u = np.tan((2 * one / n - 1) * np.pi / 4)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    vertices = np.asarray(_surface(field, u.astype(np.float32)), np.float64)
    inset = np.clip(0.5 + np.tan((square - 0.5) * np.pi / 2) / 2, 0.5 / side, 1 - 0.5 / side)
    at = (inset + np.stack([face % 3, face // 3], axis=1)) / np.array([3, 2])
    of = of.ravel()
    return Wrapped(vertices[of], _triangles(n), np.stack([at[:, 0], 1 - at[:, 1]], axis=1), u[of])


def _triangles(n: int) -> Int[np.ndarray, "T 3"]:
    """Counter-clockwise seen from outside."""
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    quads = np.stack([np.stack([a, d, c], -1), np.stack([a, c, b], -1)], axis=2).reshape(-1, 3)
    return np.concatenate([quads + face * (n + 1) ** 2 for face in range(6)])


@jax.jit
def _surface(field: Field, u):
    return jax.vmap(lambda u: to_surface(field, u))(u)
