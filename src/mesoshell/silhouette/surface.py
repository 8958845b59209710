"""A mesh that wears a surface material: what rays meet on it, in the material's terms.

Alphabet
n            interpolated normal, outward; m: the face's own                                                 world
t, b         tangents along u and v, orthonormal with n; (t, b, n) is left-handed on mirrored charts
period       world length of one period of the texture
κ            least curvature along the ray about the hit (geometry/curvature) times the period

Rays pass through the surface from within: what a material is seen by lies outside.
"""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.curvature import curvature_table, lookup, range_of
from mesoshell.geometry.mesh import Mesh, uv_stretch
from mesoshell.render.quality import Quality

#: Step past a surface, relative to the scene's size.
ADVANCE = 2e-6
#: The least ω_z that is asked for: normals are interpolated, and may look away from a ray that meets the face's front.
LEAST = 1e-3


class Hits(NamedTuple):
    """What rays meet first. face: −1 for nothing; front: from outside; bary: of the face's first two corners."""

    t: Float[np.ndarray, "R"]
    face: Int[np.ndarray, "R"]
    front: Bool[np.ndarray, "R"]
    bary: Float[np.ndarray, "R 3"]


class Local(NamedTuple):
    """Queries without light: u in periods, radius, ω and κ; and the axes (t, b, n) as rows."""

    u: Float[np.ndarray, "H 2"]
    radius: Float[np.ndarray, "H"]
    w: Float[np.ndarray, "H 3"]
    kappa: Float[np.ndarray, "H"]
    axes: Float[np.ndarray, "H 3 3"]


class Dressed:
    """A mesh ready to be met. others: triangles of further objects, numbered after the mesh's faces."""

    def __init__(self, mesh: Mesh, period: float, quality: Quality, others: Float[np.ndarray, "N 3 3"]):
        self.mesh, self.period = mesh, period
        self.count = len(mesh.faces)
        self.corners = np.concatenate([mesh.vertices[mesh.faces].astype(np.float64), others])
        self.normal = _unit(np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]))
        self.size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        self.centre = self.corners.mean(axis=(0, 1))  # Embree works in float32: keep its numbers small
        self.scene = EmbreeScene()
        TriangleMesh(self.scene, np.ascontiguousarray(self.corners - self.centre, np.float32))
        self.periods = uv_stretch(mesh) / period
        self.along_u, self.along_v = _along(mesh)
        length = quality.curve_length * period if quality.curvature_filter == "curve" else 0.0
        self.table = curvature_table(mesh, length)

    @property
    def curvature(self) -> tuple[float, float]:
        """Least and greatest κ of the table."""
        low, high = range_of(self.table)
        return low * self.period, high * self.period

    def meet(self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]) -> Hits:
        """The nearest triangle of each ray, from either side."""
        found = self.scene.run((o - self.centre).astype(np.float32), d.astype(np.float32), output=True)
        face = np.where(found["geomID"] < 0, -1, found["primID"]).astype(np.int64)
        u, v = (found[k].astype(np.float64) for k in ("u", "v"))
        bary = np.stack([1 - u - v, u, v], axis=1)
        return Hits(found["tfar"].astype(np.float64), face, _dot(self.normal[face], d) < 0, bary)

    def queries(
        self, hits: Hits, rows: Int[np.ndarray, "H"], d: Float[np.ndarray, "H 3"], cone: Float[np.ndarray, "H"]
    ) -> Local:
        """What hits ask of the material. d: directions of the rays that met them; cone: standard deviation of each ray's
        footprint across it, world."""
        face, bary = hits.face[rows], hits.bary[rows]
        n = _unit(np.einsum("hk,hki->hi", bary, self.mesh.normals[self.mesh.faces[face]].astype(np.float64)))
        t = self.along_u[face] - _dot(self.along_u[face], n)[:, None] * n
        t = np.where(_dot(t, t)[:, None] > 1e-24, t, np.cross(n, _least(n)))
        t = _unit(t)
        b = np.cross(n, t)
        b = np.where(_dot(b, self.along_v[face])[:, None] < 0, -b, b)
        axes = np.stack([t, b, n], axis=1)
        w = -np.einsum("hij,hj->hi", axes, d)
        w[:, 2] = np.maximum(w[:, 2], LEAST)
        u = np.einsum("hk,hkc->hc", bary, self.mesh.uv[face].astype(np.float64)) * self.periods
        kappa = lookup(self.table, self.mesh.faces[face], bary, d) * self.period
        return Local(u % 1.0, cone / self.period, _unit(w), kappa, axes)

    def facing(self, hits: Hits, rows: Int[np.ndarray, "H"], d: Float[np.ndarray, "H 3"]) -> np.ndarray:
        """Normals of faces that rays met, against the ray."""
        normal = self.normal[hits.face[rows]]
        return np.where(_dot(normal, d)[:, None] > 0, -normal, normal)


def _along(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """∂P/∂u and ∂P/∂v of each face; 0 where it has no area in UV."""
    p, uv = mesh.vertices[mesh.faces].astype(np.float64), mesh.uv.astype(np.float64)
    e, f = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    inverse = np.divide(1, area, out=np.zeros_like(area), where=area != 0)[:, None]
    return inverse * (b[:, 1:] * e - a[:, 1:] * f), inverse * (a[:, :1] * f - b[:, :1] * e)


def _least(n: np.ndarray) -> np.ndarray:
    """The axis that each vector has least of."""
    return np.eye(3)[np.abs(n).argmin(axis=1)]


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-30)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
