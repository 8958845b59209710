"""Paint onto a mesh: dabs of a brush on the surface become an image: grey, as `--param NAME=IMAGE` takes it, or with channels.

Notation
H, W        texels of the image over the UV square; row 0 has v = 1
S           sample points of the surface: where they lie, and in which texel. A texel without any is as the nearest that has one
E, U        edges of a face from its first corner, (3, 2) in the world and (2, 2) in UV; a direction d along the face has
            the components U E⁺ d along u and v
w           share by which a dab moves a texel to its value: (1 − (r/R)²)² at distance r of a brush of radius R

A dab reaches what is near in space, and so the other side of a UV seam, but not surfaces that face away from where it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

from mesoshell.geometry.mesh import Mesh

#: Texels of a painted image's side; sample points a texel, along an edge; most sample points, about: coordinates that repeat
#: often have fewer.
SIDE, FINE, MAX_POINTS = 512, 1.5, 4e6


@dataclass(frozen=True)
class Hit:
    """Where a ray meets the mesh."""

    point: Float[np.ndarray, "3"]
    face: int


class Canvas:
    """A mesh to paint on. lift: how far above it the surface lies that rays meet and distances are measured on (world);
    shape: (H, W)."""

    def __init__(self, mesh: Mesh, lift: float = 0.0, shape: tuple[int, int] = (SIDE, SIDE)):
        self.shape, self.faces = shape, mesh.faces
        self.vertices = mesh.vertices + np.float32(lift) * mesh.normals
        self._corners = self.vertices[mesh.faces].astype(np.float64)
        self._uv = mesh.uv.astype(np.float64)
        foot = mesh.vertices[mesh.faces].astype(np.float64)
        edges = foot[:, 1:] - foot[:, :1]
        self._normal = np.cross(edges[:, 0], edges[:, 1])
        along = np.swapaxes(self._uv[:, 1:] - self._uv[:, :1], 1, 2)
        self._toward_uv = along @ np.linalg.pinv(np.swapaxes(edges, 1, 2))
        self._centre = self._corners.mean(axis=(0, 1))
        self.size = float(np.ptp(self._corners.reshape(-1, 3), axis=0).max())

    @cached_property
    def _scene(self) -> EmbreeScene:
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, np.ascontiguousarray(self._corners - self._centre, np.float32))
        return scene

    @cached_property
    def _samples(self) -> tuple[Float[np.ndarray, "S 3"], Int[np.ndarray, "S"], Int[np.ndarray, "S"]]:
        """Points, seen from the mesh's middle and in order of x, their texels and faces."""
        edges = np.roll(self._uv, -1, axis=1) - np.roll(self._uv, -2, axis=1)
        lengths = np.linalg.norm(edges * self.shape[::-1], axis=-1)
        apex = lengths.argmin(axis=1)  # the corner across from the shortest edge
        order = (apex[:, None] + np.arange(3)) % 3
        wanted = FINE * np.maximum(np.stack([lengths.max(axis=1), lengths.min(axis=1)], axis=1), 1)
        parts = np.ceil(wanted * min(1.0, (MAX_POINTS / wanted.prod(axis=1).sum()) ** 0.5)).astype(int)
        points, uv, owner = [], [], []
        kinds, kind = np.unique(parts, axis=0, return_inverse=True)
        for k, (along, across) in enumerate(kinds):
            faces = np.flatnonzero(kind.ravel() == k)
            rows = faces[:, None], order[faces]
            weights = _inside(int(along), int(across))
            points.append(np.einsum("sk,fkc->fsc", weights, self._corners[rows]).reshape(-1, 3))
            uv.append(np.einsum("sk,fkc->fsc", weights, self._uv[rows]).reshape(-1, 2))
            owner.append(np.repeat(faces, len(weights)))
        place, inside = np.concatenate(points), np.concatenate(uv)
        column, row = (
            np.minimum((x % 1 * n).astype(int), n - 1)
            for x, n in zip((inside[:, 0], -inside[:, 1]), self.shape[::-1], strict=True)
        )
        place = (place - self._centre).astype(np.float32)
        order = np.argsort(place[:, 0])
        return place[order], (row * self.shape[1] + column)[order], np.concatenate(owner)[order]

    @cached_property
    def _nearest(self) -> Int[np.ndarray, "H W"]:
        """For each texel the nearest one that has a sample."""
        empty = np.ones(self.shape[0] * self.shape[1], bool)
        empty[self._samples[1]] = False
        nearest: Any = distance_transform_edt(empty.reshape(self.shape), return_distances=False, return_indices=True)
        row, column = nearest
        return row * self.shape[1] + column

    def prepare(self) -> None:
        """Make what the first dab would wait for."""
        _ = self._scene, self._nearest

    def hit(self, o: Float[np.ndarray, "3"], d: Float[np.ndarray, "3"]) -> Hit | None:
        """The first point of the mesh on a ray; None for a ray that misses."""
        begin, way = (np.ascontiguousarray(x[None], np.float32) for x in (o - self._centre, d))
        found = self._scene.run(begin, way, output=True)
        if found["geomID"][0] < 0:
            return None
        t = float(found["tfar"][0])
        return Hit(o + t * d, int(found["primID"][0]))

    def dab(
        self, image: Float[np.ndarray, "H W *c"], at: Hit, radius: float, value: float | Sequence[float]
    ) -> Float[np.ndarray, "H W *c"]:
        """The image with one dab of a value, of as many numbers as it has channels."""
        texels, _, weight = self._near(at, radius)
        values = np.broadcast_to(np.asarray(value, np.float64), (len(texels), *image.shape[2:]))
        return self._mixed(image, texels, weight, values)

    def comb(
        self, image: Float[np.ndarray, "H W"], at: Hit, radius: float, way: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "H W"]:
        """The image of an angle, from u toward v in turns, with one dab along a way in space: each face has its own u and v."""
        texels, faces, weight = self._near(at, radius)
        du, dv = np.einsum("sij,j->is", self._toward_uv[faces], way)
        known = (du != 0) | (dv != 0)
        angle = np.arctan2(dv, du)[known] / (2 * np.pi) % 1
        texels, weight = texels[known], weight[known]
        before = image.ravel()[texels]
        nearest = before + (angle - before + 0.5) % 1 - 0.5  # round the shorter way
        return self._mixed(image, texels, weight, nearest) % 1

    def _near(self, at: Hit, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Texel, face and weight of samples within a radius that face as the hit does."""
        place, texel, face = self._samples
        middle = (at.point - self._centre).astype(np.float32)
        first, last = np.searchsorted(place[:, 0], middle[0] + np.array([-radius, radius], np.float32))
        place, texel, face = place[first:last], texel[first:last], face[first:last]
        share = ((place - middle) ** 2).sum(axis=1) / np.float32(radius**2)
        near = np.flatnonzero(share < 1)
        near = near[self._normal[face[near]] @ self._normal[at.face] > 0]
        return texel[near], face[near], (1 - share[near]) ** 2

    def _mixed(
        self, image: np.ndarray, texels: np.ndarray, weight: np.ndarray, value: np.ndarray
    ) -> Float[np.ndarray, "H W *c"]:
        """Each texel moved to the value of its heaviest sample, by its weight."""
        order = np.argsort(weight, kind="stable")  # of several assignments the last one holds
        new = image.astype(np.float32).reshape(-1, *image.shape[2:])
        before, weight = new[texels[order]], weight[order].reshape(-1, *(1,) * (new.ndim - 1))
        new[texels[order]] = before + weight * (value[order] - before)
        return new[self._nearest]


def _inside(along: int, across: int) -> Float[np.ndarray, "S 3"]:
    """Barycentric coordinates of along · across points of a triangle: rows from the first corner to the edge across."""
    s, t = np.meshgrid((np.arange(along) + 0.5) / along, (np.arange(across) + 0.5) / across, indexing="ij")
    return np.stack([1 - s, s * (1 - t), s * t], axis=-1).reshape(-1, 3)
