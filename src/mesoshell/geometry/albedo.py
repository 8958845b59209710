"""Diffuse albedo of surfaces: a colour a mesh, or an image over its texture coordinates (no JAX)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from mesoshell.geometry.colour import Colour
from mesoshell.geometry.mesh import Mesh
from mesoshell.kept import kept

#: Least cosine of a footprint on a slanted face.
LEAST = 0.01


class Albedo:
    """Of `count` faces, which have the base colour, and of those of objects after them, by their colours or images."""

    def __init__(self, count: int, objects: Sequence[Mesh], base: Colour):
        of_objects = [np.tile(base if mesh.colour is None else mesh.colour, (len(mesh.faces), 1)) for mesh in objects]
        self._plain = np.concatenate([np.tile(base, (count, 1)), *of_objects]).astype(np.float64)
        first = (count + np.cumsum([0, *(len(mesh.faces) for mesh in objects)])).tolist()
        self._textured = [(k, mesh) for k, mesh in zip(first, objects, strict=False) if mesh.texture is not None]

    def at(
        self,
        face: Int[np.ndarray, "N"],
        bary: Float[np.ndarray, "N 2"],
        pixel: Float[np.ndarray, "N"],
        cosine: Float[np.ndarray, "N"],
    ) -> Float[np.ndarray, "N 3"]:
        """At places on faces. bary: λ₀ and λ₁; pixel: width of one there, world; cosine: of a ray and the normal."""
        out = self._plain[face]
        for first, mesh in self._textured:
            own = np.flatnonzero((face >= first) & (face < first + len(mesh.faces)))
            if len(own):
                row = face[own] - first
                weights = np.stack([bary[own, 0], bary[own, 1], 1 - bary[own].sum(axis=1)], axis=1)
                uv = np.einsum("nk,nkc->nc", weights, mesh.uv[row].astype(np.float64))
                width = pixel[own] * _stretch(mesh)[row] / np.sqrt(np.maximum(cosine[own], LEAST))
                assert mesh.texture is not None
                out[own] = mesh.texture.at(uv, width)
        return out


@kept
def _stretch(mesh: Mesh) -> Float[np.ndarray, "F"]:
    """Texture coordinates a unit of length, of each face: the root of its area's share."""
    corners, uv = mesh.vertices.astype(np.float64)[mesh.faces], mesh.uv.astype(np.float64)
    (a, b), (p, q) = ((x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (corners, uv))
    world = np.linalg.norm(np.cross(a, b), axis=1)
    return np.sqrt(np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / np.maximum(world, np.finfo(np.float64).tiny))
