"""Whether a mesh is convex: then it is dark only where it faces away from the light (NumPy and SciPy).

Notation
n, p        unit normal of a face, and a corner of it
support     the largest v · n of all vertices v: a corner of the convex hull has it
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, KDTree, QhullError

from mesoshell.geometry.mesh import Mesh
from mesoshell.kept import kept

#: So far may a vertex lie in front of a face, relative to the mesh's size.
TOLERANCE = 1e-6
#: Faces that are tried against all vertices first: most meshes that are not convex show it there.
TRIED = 64


@kept
def is_convex(mesh: Mesh) -> bool:
    """Whether no vertex lies in front of any face."""
    v = mesh.vertices.astype(np.float64)
    v -= (v.min(axis=0) + v.max(axis=0)) / 2
    most = TOLERANCE * np.ptp(v, axis=0).max()
    p = v[mesh.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    some = np.linspace(0, len(n) - 1, min(TRIED, len(n))).astype(int)
    own = np.einsum("fi,fi->f", p[:, 0], n)
    if ((v @ n[some].T).max(axis=0) > own[some] + most).any():
        return False
    corners = _corners_of_hull(v)
    found = corners[_farthest(corners, n)]
    return not (np.einsum("fi,fi->f", found, n) > own + most).any()


def _corners_of_hull(v: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "K 3"]:
    """Corners of the convex hull, or, of a flat mesh, of its outline."""
    try:
        return v[ConvexHull(v).vertices]
    except QhullError:
        _, axes = np.linalg.eigh(v.T @ v)  # the last two lie in the plane
        return v[ConvexHull(v @ axes[:, 1:]).vertices]


def _farthest(corners: Float[np.ndarray, "K 3"], n: Float[np.ndarray, "F 3"]) -> np.ndarray:
    """For each direction, the corner that lies farthest along it: the nearest to n times the largest |corner| among corners
    that a fourth coordinate brings to that length."""
    squared = np.einsum("ki,ki->k", corners, corners)
    longest = squared.max()
    lifted = np.column_stack([corners, np.sqrt(longest - squared)])
    return np.asarray(KDTree(lifted).query(np.column_stack([np.sqrt(longest) * n, np.zeros(len(n))]))[1])
