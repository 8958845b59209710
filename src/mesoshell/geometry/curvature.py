"""Curvature of a mesh: principal values at its vertices, and the table of least curvatures that a renderer reads.

Notation
n           unit normal of a vertex (the mesh's own)                                                        (V, 3)
k₁ ≥ k₂     principal values, 1 / world length, positive where the surface is convex seen from outside      (V, 2)
d₁, d₂      unit principal directions, (d₁, d₂, n) right-handed; any in the tangent plane at umbilics       (V, 2, 3)
κ(d)        k₁ cos² θ + k₂ sin² θ, θ the angle from d₁ to d projected to the tangent plane (Euler)
m           unit normal of the plane of n and d: it cuts the surface where m·(X − P) = 0
g           m·(X − P) at a vertex X; an edge is crossed where just one of its ends has g < 0
lane        one such curve on its way in one sense, about to enter a triangle by a half-edge (`topology`)
θ_j         j π / D, from t = d₁ to b = d₂; both senses of a direction are walked, so θ and θ + π are the same

Kuznetsov et al. 2022, "Rendering neural materials on curved surfaces": principal values by libigl (Panozzo, Puppo, Rocca
2010: a quadric through the vertices RINGS edges around), κ along the ray by Euler's formula, interpolated over the face,
and its least value on a short curve in the plane of ray and normal. A table holds that value at each vertex for D
directions; the ray's part along n does not change the plane.

A vertex is mended where several surfaces touch, where it has too few neighbours, and where its curvature does not fit
them: their heights z over tangential offsets u are x·u − κ(u) |u|² / 2, with x the lean of the normal that fits best, and
weights 1 / |u, z|⁴, so that the remainder is in units of curvature. Sliver triangles spoil a fit or its frame: then the
remainder exceeds that of a plane, or the lean is large.

A walk decides by the sign of g alone, and zero counts as positive wherever it is met: a curve through a vertex or along
an edge is that of a plane just beside it (along a border, that one may miss the mesh). So each face that a plane meets has
just two crossed edges, a curve ends at a border or closes, and no lane enters a face twice.

Where a texture unit is s long in the world, κ is s κ in texture units (for one UV unit s is `mesh.uv_stretch`).
Float64 inside, on the mesh about its centre; libigl sees edges of length 1 on average.
"""

from dataclasses import dataclass
from typing import NamedTuple

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, counted
from mesoshell.geometry.normals import face_normals
from mesoshell.geometry.topology import pair_edges, split_fans

#: The smallest that libigl takes, and the most exact: the error of a quadric grows with its distance.
RINGS = 2
#: A fit is doubtful if its remainder exceeds this multiple of a plane's, or its lean 45 degrees.
GREATEST_REMAINDER = 1.25
GREATEST_LEAN = 1.0
#: A direction whose squared sine with the normal is at most this has no projection.
LEAST_SINE2 = 1e-12


@dataclass(frozen=True)
class Principal:
    """Principal curvature at vertices; float64. `mended` counts those that were mended, `notes` reports them."""

    values: Float[np.ndarray, "V 2"]
    directions: Float[np.ndarray, "V 2 3"]
    mended: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Least curvature of D curves through each of V vertices; float32. `mended` and `notes` as in Principal."""

    kappa: Float[np.ndarray, "V D"]  # 1 / world length
    tangent: Float[np.ndarray, "V 3"]
    bitangent: Float[np.ndarray, "V 3"]
    mended: int
    notes: tuple[str, ...]


def principal(mesh: Mesh) -> Principal:
    """Principal curvature of a mesh; where it cannot be estimated, the mean of the neighbours' tensors, or 0 without any."""
    points, edge = _unit_edges(mesh)
    faces, copied = split_fans(mesh.faces, pair_edges(mesh.faces), len(points))
    origin = np.append(np.arange(len(points)), copied)
    values, directions, bad = _fitted(points[origin], faces, mesh.normals[origin].astype(np.float64))
    rounding = float(np.finfo(np.float32).eps * np.abs(mesh.vertices).max()) / edge
    bad |= _doubtful(points[origin], faces, values, directions, rounding)
    bad[copied] = True
    good = ~bad[: len(points)]
    values, directions, lost = _mend(values[: len(points)], directions[: len(points)], good, mesh.faces)
    mended, notes = int((~good).sum()), []
    if mended > lost:
        notes.append(f"curvature of {counted(mended - lost, 'vertex', 'vertices')} taken from the neighbours")
    if lost:
        notes.append(f"{counted(lost, 'vertex', 'vertices')} taken as flat: no neighbour has a usable curvature")
    return Principal(values / edge, directions, mended, tuple(notes))


def along(
    values: Float[np.ndarray, "*#at 2"], directions: Float[np.ndarray, "*#at 2 3"], d: Float[np.ndarray, "*#at 3"]
) -> Float[np.ndarray, "*at"]:
    """Normal curvature κ(d) for a d of any length; the mean of the two values where d is along the normal."""
    x, y = np.moveaxis(np.einsum("...ki,...i->...k", directions, d) ** 2, -1, 0)
    k1, k2 = np.moveaxis(values, -1, 0)
    upright = x + y <= LEAST_SINE2 * np.einsum("...i,...i->...", d, d)
    return np.where(upright, (k1 + k2) / 2, (x * k1 + y * k2) / np.where(upright, 1, x + y))


def curvature_table(mesh: Mesh, length: float, directions: int = 32) -> Table:
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
    return Table(held, t.astype(np.float32), b.astype(np.float32), curvature.mended, curvature.notes)


def lookup(
    table: Table, faces: Int[np.ndarray, "P 3"], bary: Float[np.ndarray, "P 3"], d: Float[np.ndarray, "P 3"]
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


def range_of(table: Table) -> tuple[float, float]:
    """The least and the greatest curvature that a lookup can give."""
    return float(table.kappa.min()), float(table.kappa.max())


def _unit_edges(mesh: Mesh) -> tuple[Float[np.ndarray, "V 3"], float]:
    """Vertices relative to their mean, in units of the mean edge length, and that length."""
    points = mesh.vertices.astype(np.float64)
    corner = points[mesh.faces]
    edge = float(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=-1).mean())
    return (points - points.mean(axis=0)) / edge, edge


def _fitted(
    points: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "F 3"], n: Float[np.ndarray, "W 3"]
) -> tuple[Float[np.ndarray, "W 2"], Float[np.ndarray, "W 2 3"], Bool[np.ndarray, "W"]]:
    """libigl's curvature, with directions projected to our tangent planes, and a mask of where it has none."""
    *fit, unfit = igl.principal_curvature(points, faces.astype(np.int64), RINGS, True)
    d1, d2, k1, k2 = map(np.asarray, fit)
    values = np.stack([k1, k2], axis=1)
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    d1 = np.where(d1.any(axis=1, keepdims=True), d1, np.cross(d2, n))  # a direction of curvature 0 is 0
    d1 -= (d1 * n).sum(axis=1, keepdims=True) * n
    size = np.linalg.norm(d1, axis=1, keepdims=True)
    defined = size > 0.1
    bad = ~np.isfinite(values).all(axis=1) | (~defined[:, 0] & values.any(axis=1))
    bad[unfit] = True
    values[bad] = 0
    some = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    d1 = np.where(defined, d1 / np.where(defined, size, 1), some / np.linalg.norm(some, axis=1, keepdims=True))
    return values, np.stack([d1, np.cross(n, d1)], axis=1), bad


def _doubtful(
    points: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "F 3"],
    values: Float[np.ndarray, "W 2"],
    directions: Float[np.ndarray, "W 2 3"],
    rounding: float,
) -> Bool[np.ndarray, "W"]:
    """Mask of vertices whose curvature does not fit the rings around them."""
    near = igl.adjacency_matrix(faces.astype(np.int64))
    i, j = (near + near @ near).nonzero()
    apart = (points[i] != points[j]).any(axis=1)  # excludes the vertex itself and its copies
    i, j = i[apart], j[apart]
    offset = points[j] - points[i]
    u, v = np.einsum("lki,li->kl", directions[i], offset)
    z = (np.cross(directions[:, 0], directions[:, 1])[i] * offset).sum(axis=1)
    weight = 1 / (offset * offset).sum(axis=1) ** 2

    def mean(x: Float[np.ndarray, "L"]) -> Float[np.ndarray, "W"]:
        return np.bincount(i, weight * x, len(points)) / np.bincount(i, minlength=len(points))

    uu, uv, vv = mean(u * u), mean(u * v), mean(v * v)
    det = np.maximum(uu * vv - uv * uv, 1e-12 * uu * vv + 1e-300)

    def remainder(h: Float[np.ndarray, "L"]) -> tuple[Float[np.ndarray, "W"], Float[np.ndarray, "W"]]:
        uh, vh = mean(u * h), mean(v * h)
        x, y = (vv * uh - uv * vh) / det, (uu * vh - uv * uh) / det
        return np.sqrt(mean((h - x[i] * u - y[i] * v) ** 2)), np.hypot(x, y)

    fitted, lean = remainder(z + (values[i, 0] * u * u + values[i, 1] * v * v) / 2)
    plane, _ = remainder(z)
    noise = rounding * np.sqrt(mean(np.ones(len(i))))
    return (fitted > GREATEST_REMAINDER * plane + noise) | (lean > GREATEST_LEAN)


def _mend(
    values: Float[np.ndarray, "V 2"],
    directions: Float[np.ndarray, "V 2 3"],
    good: Bool[np.ndarray, "V"],
    faces: Int[np.ndarray, "F 3"],
) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, "V 2 3"], int]:
    """Replace bad values by the mean of good neighbours' tensors, ring by ring, and count those without any.

    A tensor is a mean value and half the difference as a vector at twice the angle of d₁, here of its projection.
    """
    values, directions, good = values.copy(), directions.copy(), good.copy()
    frame, n = directions.copy(), np.cross(directions[:, 0], directions[:, 1])
    pairs = np.stack(igl.adjacency_matrix(faces.astype(np.int64)).nonzero(), axis=1)
    pairs = pairs[~good[pairs[:, 0]]]
    while good[pairs[:, 1]].any():
        i, j = pairs[good[pairs[:, 1]]].T
        x, y = np.einsum("lki,li->kl", frame[i], directions[j, 0])
        twice, half = 2 * np.arctan2(y, x), (values[j, 0] - values[j, 1]) / 2
        at, which, count = np.unique(i, return_inverse=True, return_counts=True)
        parts = (values[j].mean(axis=1), half * np.cos(twice), half * np.sin(twice))
        mean, x, y = (np.bincount(which, part) / count for part in parts)
        angle, half = np.arctan2(y, x) / 2, np.hypot(x, y)
        values[at] = np.stack([mean + half, mean - half], axis=1)
        directions[at, 0] = np.einsum("kv,vki->vi", [np.cos(angle), np.sin(angle)], frame[at])
        directions[at, 1] = np.cross(n[at], directions[at, 0])
        good[at] = True
        pairs = pairs[~good[pairs[:, 0]]]
    values[~good] = 0
    return values, directions, int((~good).sum())


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
