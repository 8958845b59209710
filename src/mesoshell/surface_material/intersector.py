"""Intersects rays with a mesh with a surface material, and makes the material's queries (surface_material/tables).

Rays pass through the surface from within: the material is seen from outside only.
"""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.curvature import lookup
from mesoshell.surface_material.tables import MIN_COSINE, SurfaceTables

#: Step past a surface, relative to the scene's size.
ADVANCE = 2e-6


class Hits(NamedTuple):
    """First hits of rays. face: −1 for nothing; front: from outside; bary: of the face's first two corners."""

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


class SurfaceIntersector:
    """A mesh ready for intersection. others: triangles of further objects, numbered after the mesh's faces."""

    def __init__(self, tables: SurfaceTables, others: Float[np.ndarray, "N 3 3"]):
        mesh = tables.mesh
        self.tables, self.count = tables, len(mesh.faces)
        self.corners = np.concatenate([mesh.vertices[mesh.faces].astype(np.float64), others])
        self.normal = _unit(np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]))
        self.size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        self.centre = self.corners.mean(axis=(0, 1))  # Embree works in float32: keep its numbers small
        self.scene = EmbreeScene(robust=True)  # no ray passes at an edge, two in 1000 at a vertex
        TriangleMesh(self.scene, np.ascontiguousarray(self.corners - self.centre, np.float32))

    def meet(self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]) -> Hits:
        """The nearest triangle of each ray, from either side."""
        hits = self.scene.run((o - self.centre).astype(np.float32), d.astype(np.float32), output=True)
        face = np.where(hits["geomID"] < 0, -1, hits["primID"]).astype(np.int64)
        u, v = (hits[k].astype(np.float64) for k in ("u", "v"))
        bary = np.stack([1 - u - v, u, v], axis=1)
        return Hits(hits["tfar"].astype(np.float64), face, _dot(self.normal[face], d) < 0, bary)

    def queries(
        self, hits: Hits, rows: Int[np.ndarray, "H"], d: Float[np.ndarray, "H 3"], cone: Float[np.ndarray, "H"]
    ) -> Local:
        """Queries to the material at hits. d: directions of their rays; cone: standard deviation of each ray's footprint across
        it, world."""
        tables, mesh = self.tables, self.tables.mesh
        face, bary = hits.face[rows], hits.bary[rows]
        n = _unit(np.einsum("hk,hki->hi", bary, mesh.normals[mesh.faces[face]].astype(np.float64)))
        t = tables.along_u[face] - _dot(tables.along_u[face], n)[:, None] * n
        t = _unit(np.where(_dot(t, t)[:, None] > 1e-24, t, np.cross(n, _least(n))))
        b = np.cross(n, t)
        b = np.where(_dot(b, tables.along_v[face])[:, None] < 0, -b, b)
        axes = np.stack([t, b, n], axis=1)
        w = -np.einsum("hij,hj->hi", axes, d)
        w[:, 2] = np.maximum(w[:, 2], MIN_COSINE)
        u = np.einsum("hk,hkc->hc", bary, tables.uv[face])
        kappa = lookup(tables.table, mesh.faces[face], bary, d) * tables.period
        return Local(u % 1.0, cone / tables.period, _unit(w), kappa, axes)

    def facing(self, hits: Hits, rows: Int[np.ndarray, "H"], d: Float[np.ndarray, "H 3"]) -> np.ndarray:
        """Normals of hit faces, turned against the ray."""
        normal = self.normal[hits.face[rows]]
        return np.where(_dot(normal, d)[:, None] > 0, -normal, normal)


def _least(n: np.ndarray) -> np.ndarray:
    """The axis of each vector's smallest component."""
    return np.eye(3)[np.abs(n).argmin(axis=1)]


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-30)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
