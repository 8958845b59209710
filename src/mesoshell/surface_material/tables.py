"""A mesh with a surface material, as tables (NumPy only: both engines read them).

Notation
u, v         texture coordinates in periods; one period is `period` long in the world
t, b, n      at a hit: n interpolated, outward; t along ∂P/∂u, b along ∂P/∂v, orthonormal; left-handed on mirrored charts
κ            least curvature along the ray about the hit (geometry/curvature) times the period
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.curvature import CurvatureTable, curvature_table, range_of
from mesoshell.geometry.mesh import Mesh, uv_stretch
from mesoshell.kept import kept
from mesoshell.render.quality import Quality

#: Least ω_z of a query: interpolated normals may face away from a ray that meets the face's front.
MIN_COSINE = 1e-3


@dataclass(frozen=True, eq=False)
class SurfaceTables:
    """uv: of corners, periods; along_u, along_v: ∂P/∂u and ∂P/∂v of each face, 0 where it has no area in UV; table: of κ,
    in world units."""

    mesh: Mesh
    period: float
    uv: Float[np.ndarray, "F 3 2"]
    along_u: Float[np.ndarray, "F 3"]
    along_v: Float[np.ndarray, "F 3"]
    table: CurvatureTable

    def notes(self, trained: tuple[float, float]) -> tuple[str, ...]:
        """Notes on curvature that was mended, or for which the material was not trained."""
        kappa: np.ndarray = self.table.kappa * self.period
        wrong = int(((kappa < trained[0] - 1e-3) | (kappa > trained[1] + 1e-3)).any(axis=1).sum())
        if not wrong:
            return self.table.notes
        low, high = (self.period * x for x in range_of(self.table))
        note = (
            f"curvature is outside the trained {trained[0]:g} to {trained[1]:g} per period at {wrong} of {len(kappa)} "
            f"vertices ({low:.2g} to {high:.2g}) and taken as the nearest value inside: a smaller scale lowers it"
        )
        return (*self.table.notes, note)


def surface_tables(mesh: Mesh, period: float, quality: Quality) -> SurfaceTables:
    """Tables for a texture whose periods have this world length, averaged over the surface."""
    how = quality.curvature_filter
    table = _curvature(mesh, quality.curve_length * period if how in ("curve", "unscaled") else 0.0)
    if how == "mean":
        mean = table.kappa.mean(axis=1, keepdims=True)
        table = replace(table, kappa=np.broadcast_to(mean, table.kappa.shape).copy())
    if how == "unscaled":
        table = replace(table, kappa=table.kappa / np.float32(period))
    uv = mesh.uv.astype(np.float64) * (uv_stretch(mesh) / period)
    return SurfaceTables(mesh, period, uv, *_along(mesh, uv), table)


@kept
def _curvature(mesh: Mesh, length: float) -> CurvatureTable:
    return curvature_table(mesh, length)


def _along(mesh: Mesh, uv: Float[np.ndarray, "F 3 2"]) -> tuple[np.ndarray, np.ndarray]:
    p = mesh.vertices[mesh.faces].astype(np.float64)
    e, f = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    inverse = np.divide(1, area, out=np.zeros_like(area), where=area != 0)[:, None]
    return inverse * (b[:, 1:] * e - a[:, 1:] * f), inverse * (a[:, :1] * f - b[:, :1] * e)
