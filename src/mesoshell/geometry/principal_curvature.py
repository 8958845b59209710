"""Principal curvature of a mesh at its vertices.

Notation
n           unit normal of a vertex (the mesh's own)                                                        (V, 3)
k₁ ≥ k₂     principal values, 1 / world length, positive where the surface is convex seen from outside      (V, 2)
d₁, d₂      unit principal directions, (d₁, d₂, n) right-handed; any in the tangent plane at umbilics       (V, 2, 3)
κ(d)        k₁ cos² θ + k₂ sin² θ, θ the angle from d₁ to d projected to the tangent plane (Euler)

By libigl (Panozzo, Puppo, Rocca 2010): a quadric through the vertices RINGS edges around.

A vertex is mended where several surfaces touch, where it has too few neighbours, and where its curvature does not fit
them: their heights z over tangential offsets u are x·u − κ(u) |u|² / 2, with x the lean of the normal that fits best, and
weights 1 / |u, z|⁴, so that the remainder is in units of curvature. Sliver triangles spoil a fit or its frame: then the
remainder exceeds that of a plane, or the lean is large.

Float64 inside, on the mesh about its centre; libigl sees edges of length 1 on average.
"""

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.mesh import Mesh, count_of
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
        notes.append(f"curvature of {count_of(mended - lost, 'vertex', 'vertices')} taken from the neighbours")
    if lost:
        notes.append(f"{count_of(lost, 'vertex', 'vertices')} taken as flat: no neighbour has a usable curvature")
    return Principal(values / edge, directions, mended, tuple(notes))


def along(
    values: Float[np.ndarray, "*#at 2"], directions: Float[np.ndarray, "*#at 2 3"], d: Float[np.ndarray, "*#at 3"]
) -> Float[np.ndarray, "*at"]:
    """Normal curvature κ(d) for a d of any length; the mean of the two values where d is along the normal."""
    x, y = np.moveaxis(np.einsum("...ki,...i->...k", directions, d) ** 2, -1, 0)
    k1, k2 = np.moveaxis(values, -1, 0)
    upright = x + y <= LEAST_SINE2 * np.einsum("...i,...i->...", d, d)
    return np.where(upright, (k1 + k2) / 2, (x * k1 + y * k2) / np.where(upright, 1, x + y))


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
