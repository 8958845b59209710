"""Curvature along rays: the least on a curve through each vertex, as a table that a renderer reads.

Notation
n, κ(d)     normal of a vertex, and curvature along d                                (geometry/principal_curvature)
m           unit normal of the plane of n and d: it cuts the surface where m·(X − P) = 0
g           m·(X − P) at a vertex X; an edge is crossed where just one of its ends has g < 0
lane        one such curve on its way in one sense, about to enter a triangle by a half-edge (`topology`)
θ_j         j π / D, from t = d₁ to b = d₂; both senses of a direction are walked, so θ and θ + π are the same

Kuznetsov et al. 2022, "Rendering neural materials on curved surfaces": κ along the ray by Euler's formula, interpolated
over the face, and its least value on a short curve in the plane of ray and normal. A table holds that value at each vertex
for D directions; the ray's part along n does not change the plane.

A walk decides by the sign of g alone, and zero counts as positive wherever it is met: a curve through a vertex or along
an edge is that of a plane just beside it (along a border, that one may miss the mesh). So each face that a plane meets has
just two crossed edges, a curve ends at a border or closes, and no lane enters a face twice.

Where a texture unit is s long in the world, κ is s κ in texture units (for one UV unit s is `mesh.uv_stretch`).
Float64 inside, on the mesh about its centre.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.geometry.normals import face_normals
from mesoshell.geometry.principal_curvature import Principal, along, principal
from mesoshell.geometry.topology import pair_edges


@dataclass(frozen=True)
class CurvatureTable:
    """Least curvature of D curves through each of V vertices; float32. `mended` and `notes` as in Principal."""

    kappa: Float[np.ndarray, "V D"]  # 1 / world length
    tangent: Float[np.ndarray, "V 3"]
    bitangent: Float[np.ndarray, "V 3"]
    mended: int
    notes: tuple[str, ...]


def curvature_table(mesh: Mesh, length: float, directions: int = 32) -> CurvatureTable:
    """Least curvature within length / 2 (world, along the curve) to both sides of each vertex; at it if length is 0.

    Raises InputError for a length that is negative or not finite.
    """
    if not 0 <= length < np.inf:
        raise InputError("length of curves", f"must be finite and not negative, not {length:g}")
    curvature = principal(mesh)
    surface = _surface(mesh, curvature)
    t, b = np.moveaxis(curvature.directions, 1, 0)
    kappa = np.empty((len(t), directions))
    for j, angle in enumerate(np.arange(directions) * np.pi / directions):
        d, m = np.cos(angle) * t + np.sin(angle) * b, np.sin(angle) * t - np.cos(angle) * b
        kappa[:, j] = along(curvature.values, curvature.directions, d)
        if length > 0:
            _lower(kappa[:, j], surface, m, length / 2)
    most = float(np.finfo(np.float32).max)
    held = np.clip(kappa, -most, most).astype(np.float32)
    return CurvatureTable(held, t.astype(np.float32), b.astype(np.float32), curvature.mended, curvature.notes)


def lookup(
    table: CurvatureTable, faces: Int[np.ndarray, "P 3"], bary: Float[np.ndarray, "P 3"], d: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "P"]:
    """Curvature along d, of any length, at points given by their faces' vertices and barycentric coordinates.

    Renderers call this. At a vertex whose normal is parallel to d, it is the curvature of any direction.
    """
    count = table.kappa.shape[1]
    x, y = ((axis[faces] * d[:, None]).sum(axis=-1) for axis in (table.tangent, table.bitangent))
    angle = np.arctan2(y, x) * (count / np.pi)
    low = np.floor(angle)
    j = low.astype(np.int64)
    before, after = table.kappa[faces, j % count], table.kappa[faces, (j + 1) % count]
    return (bary * (before + (angle - low) * (after - before))).sum(axis=-1)


def range_of(table: CurvatureTable) -> tuple[float, float]:
    """The least and the greatest curvature that a lookup can give."""
    return float(table.kappa.min()), float(table.kappa.max())


class _Surface(NamedTuple):
    points: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    normals: Float[np.ndarray, "F 3"]
    across: Int[np.ndarray, "H"]  # the half-edge on the other side of one, -1 at a border
    values: Float[np.ndarray, "V 2"]
    directions: Float[np.ndarray, "V 2 3"]


class _Lanes(NamedTuple):
    curve: Int[np.ndarray, "L"]  # the vertex that it began at
    first: Int[np.ndarray, "L"]  # the face that it began in
    half: Int[np.ndarray, "L"]  # the half-edge by which it enters a face
    g: Float[np.ndarray, "L 2"]  # at that half-edge's tail and head
    left: Float[np.ndarray, "L"]  # how far it still has to go


def _surface(mesh: Mesh, curvature: Principal) -> _Surface:
    points = mesh.vertices.astype(np.float64)
    points -= points.mean(axis=0)
    edges = pair_edges(mesh.faces)
    across = np.where(edges.opposed, edges.partner, -1).ravel()
    return _Surface(
        points, mesh.faces, face_normals(points, mesh.faces), across, curvature.values, curvature.directions
    )


def _lower(kappa: Float[np.ndarray, "V"], surface: _Surface, m: Float[np.ndarray, "V 3"], left: float) -> None:
    """Lower each vertex's κ to the least on the curve of its plane, up to `left` to both sides."""
    lanes = _begin(surface, m, left)
    for _ in range(len(surface.faces)):
        if not len(lanes.curve):
            break
        met, onward, going = _step(surface, m, lanes)
        np.minimum.at(kappa, lanes.curve, met)
        lanes = _Lanes(*(x[going] for x in onward))


def _begin(surface: _Surface, m: Float[np.ndarray, "V 3"], left: float) -> _Lanes:
    """A lane in each triangle where the plane of a corner cuts the side across: by the edge to the end with g < 0."""
    corner = surface.points[surface.faces]
    ahead, behind = (
        np.einsum("fki,fki->fk", m[surface.faces], np.roll(corner, turn, axis=1) - corner) for turn in (-1, 1)
    )
    f, k = np.nonzero((ahead < 0) != (behind < 0))
    ahead, behind = ahead[f, k], behind[f, k]
    g = np.where(ahead < 0, (np.zeros(len(f)), ahead), (behind, np.zeros(len(f)))).T
    half = 3 * f + np.where(ahead < 0, k, (k + 2) % 3)
    return _Lanes(surface.faces[f, k].astype(np.int64), f, half, g, np.full(len(f), left))


def _step(
    surface: _Surface, m: Float[np.ndarray, "V 3"], lanes: _Lanes
) -> tuple[Float[np.ndarray, "L"], _Lanes, Bool[np.ndarray, "L"]]:
    """Cross one triangle: the least curvature met in it, the lanes at the next one, and which of them go on."""
    f, k = np.divmod(lanes.half, 3)
    vertex = surface.faces[f[:, None], (k[:, None] + np.arange(3)) % 3]
    corner, plane = surface.points[vertex], m[lanes.curve]
    g0, g1 = lanes.g.T
    g2 = np.einsum("li,li->l", plane, corner[:, 2] - surface.points[lanes.curve])
    ahead = (g2 < 0) == (g0 < 0)  # it leaves by the edge from 1 to 2, else by that from 2 to 0
    tail, head = np.where(ahead, (g1, g2), (g2, g0))
    enter, leave, zero = g0 / (g0 - g1), tail / (tail - head), np.zeros(len(f))
    bary_in = np.stack([1 - enter, enter, zero], axis=1)
    bary_out = np.where(ahead, (zero, 1 - leave, leave), (leave, zero, 1 - leave)).T
    d = np.cross(plane, surface.normals[f])
    kappa = along(surface.values[vertex], surface.directions[vertex], d[:, None])
    start, end = np.einsum("lk,lk->l", bary_in, kappa), np.einsum("lk,lk->l", bary_out, kappa)
    size = np.linalg.norm(np.einsum("lk,lki->li", bary_out - bary_in, corner), axis=1)
    met = np.minimum(start, start + lanes.left / np.maximum(size, lanes.left) * (end - start))
    half = surface.across[3 * f + (k + np.where(ahead, 1, 2)) % 3]
    onward = _Lanes(lanes.curve, lanes.first, half, np.stack([head, tail], axis=1), lanes.left - size)
    return met, onward, (half >= 0) & (onward.left > 0) & (half // 3 != lanes.first)
