"""Unit normals of faces and vertices.

Notation
m       unit normal of a face                               (F, 3)
θ       angle of a face at a corner                         (F, 3), radians
n       unit normal of a vertex, Σ θ m over its faces       (V, 3)
x       point of the convex hull of a vertex's m

A shell can leave a vertex only along an n with n·m > 0 for every m around it. Where the plain average fails, the best n
(the greatest least n·m) is the direction of the hull's point nearest to the origin: by duality that point's length is
the least n·m, and where the hull holds the origin no such n exists. Gilbert's iteration finds it: step from x to the
nearest point on the segment to the m that lies furthest back.

Sources: Thürmer and Wüthrich 1998 (angle weights); Gilbert 1966 (nearest point of a hull). All in float64.
"""

import numpy as np
from jaxtyping import Float, Int

#: A normal whose cosine with a face of its vertex is less than this (84 degrees) is replaced by the best one.
MIN_COSINE = 0.1
STEPS = 256


def face_normals(points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Unit normals of faces that have an area."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def vertex_normals(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "V 3"], int]:
    """Unit normals of vertices that all have a face, and how many of them are not the average."""
    m = face_normals(points, faces)
    weighted = _angles(points, faces)[..., None] * m[:, None]
    vertex = faces.ravel()
    flat = weighted.reshape(-1, 3)
    total = np.stack([np.bincount(vertex, flat[:, i], len(points)) for i in range(3)], axis=1)
    some = np.empty_like(total)
    some[vertex] = np.repeat(m, 3, axis=0)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    n = np.where(length > 1e-12, total / np.maximum(length, 1e-12), some)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return _turn(n, m, faces)


def _angles(points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    corner = points[faces]
    ahead = np.roll(corner, -1, axis=1) - corner
    back = np.roll(corner, 1, axis=1) - corner
    sine = np.linalg.norm(np.cross(ahead, back), axis=-1)
    return np.arctan2(sine, (ahead * back).sum(axis=-1))


def _turn(
    n: Float[np.ndarray, "V 3"], m: Float[np.ndarray, "F 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "V 3"], int]:
    cosine = np.einsum("fki,fi->fk", n[faces], m)
    poor = np.zeros(len(n), bool)
    poor[faces[cosine < MIN_COSINE]] = True
    if not poor.any():
        return n, 0
    corner = np.flatnonzero(poor[faces.ravel()])
    corner = corner[np.argsort(faces.ravel()[corner], kind="stable")]
    vertex, starts, which = np.unique(faces.ravel()[corner], return_index=True, return_inverse=True)
    best, least = _nearest_to_origin(n[vertex], m[corner // 3], starts, which)
    before = np.minimum.reduceat(np.einsum("ci,ci->c", n[vertex][which], m[corner // 3]), starts)
    better = (least > before) & (least > 0)
    turned = n.copy()
    turned[vertex[better]] = best[better]
    return turned, int(better.sum())


def _nearest_to_origin(
    x: Float[np.ndarray, "W 3"], m: Float[np.ndarray, "C 3"], starts: Int[np.ndarray, "W"], which: Int[np.ndarray, "C"]
) -> tuple[Float[np.ndarray, "W 3"], Float[np.ndarray, "W"]]:
    """Best direction of each of W vertices and its least cosine; corner c, sorted by vertex, belongs to which[c]."""
    best, least = x, np.full(len(x), -np.inf)
    for _ in range(STEPS):
        length = np.maximum(np.linalg.norm(x, axis=1), 1e-12)
        along = np.einsum("ci,ci->c", x[which], m)
        worst = np.minimum.reduceat(along, starts)
        better = worst / length > least
        best = np.where(better[:, None], x / length[:, None], best)
        least = np.where(better, worst / length, least)
        furthest = np.empty(len(x), np.int64)
        hit = np.flatnonzero(along == worst[which])
        furthest[which[hit]] = hit
        step = m[furthest] - x
        share = np.clip(-(x * step).sum(axis=1) / np.maximum((step * step).sum(axis=1), 1e-300), 0, 1)
        x = x + share[:, None] * step
    return best, least
