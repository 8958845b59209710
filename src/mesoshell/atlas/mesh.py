"""The surface that the texture is wrapped on, as triangles.

Alphabet
cube        six squares of n × n quads, the cubemap's: no triangle crosses a side of the texture's image
vertices    F_uv⁻¹ of their directions; those on an edge of the cube are there once for each square, at one place

It is closed wherever F_uv⁻¹ is: everywhere, since it is continuous on the sphere.
"""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from mesoshell.atlas.field import Field, to_surface
from mesoshell.atlas.layout import on_faces


class Wrapped(NamedTuple):
    """uv: of the cubemap's image, v upward."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "T 3"]
    uv: Float[np.ndarray, "V 2"]
    u: Float[np.ndarray, "V 3"]


def wrapped(field: Field, n: int = 48) -> Wrapped:
    """In the box's units; n: quads a side of the cube."""
    grid = np.linspace(0, 1, n + 1)
    y, x = np.meshgrid(grid, grid, indexing="ij")
    square = np.stack([x, y], axis=-1).reshape(-1, 2)
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    quads = np.stack([np.stack([a, c, d], -1), np.stack([a, b, c], -1)], axis=2).reshape(-1, 3)
    places, faces, uv = [], [], []
    for face in range(6):
        # equal angles, not equal lengths: triangles of one size on the sphere
        p = 0.5 + np.tan((square - 0.5) * np.pi / 2) / 2
        places.append(on_faces(p, np.full(len(p), face)))
        faces.append(quads + face * len(p))
        uv.append((p + np.array([face % 3, face // 3])) / [3, 2])
    u = np.concatenate(places)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    at = np.concatenate(uv)
    vertices = np.asarray(_surface(field, u.astype(np.float32)), np.float64)
    return Wrapped(vertices, np.concatenate(faces), np.stack([at[:, 0], 1 - at[:, 1]], axis=1), u)


@partial(jax.jit)
def _surface(field: Field, u):
    return jax.vmap(lambda u: to_surface(field, u))(u)
