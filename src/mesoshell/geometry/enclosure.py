"""Form factor of a mesh to all surfaces: how much interreflection can add (Embree).

Notation
n, ω        outward normal of a point; a direction about it, with density cos θ / π
share       of these directions that meet a surface: the form factor to all surfaces, itself included
"""

from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from mesoshell.geometry.mesh import Mesh
from mesoshell.kept import kept

#: Points on each mesh, and directions at each: a share of 0.25 is known to 0.01 or better.
_POINTS, _DIRECTIONS = 512, 16
#: Offset of ray origins from their surface, relative to its size; and the least that float32 needs, relative to the scene's.
_OFFSET, _MIN_OFFSET = 1e-4, 1e-6


@kept
def enclosure(meshes: Sequence[Mesh]) -> float:
    """Largest over the meshes of the mean share over a mesh's surface, in [0, 1]. Deterministic."""
    corners = [m.vertices.astype(np.float64)[m.faces] for m in meshes]
    every = np.concatenate(corners)
    size, centre = float(np.ptp(every.reshape(-1, 3), axis=0).max()), every.mean(axis=(0, 1))
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(every - centre, np.float32))
    random = np.random.default_rng(0)
    return max(_share(scene, part - centre, size, random) for part in corners)


def _share(scene: EmbreeScene, corners: np.ndarray, size: float, random: np.random.Generator) -> float:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    face = random.choice(len(corners), _POINTS, p=area / area.sum())
    n = np.repeat(normal[face] / area[face, None], _DIRECTIONS, axis=0)
    weights = random.dirichlet((1, 1, 1), _POINTS)
    x = np.repeat(np.einsum("ik,ikj->ij", weights, corners[face]), _DIRECTIONS, axis=0)
    sphere = random.normal(size=x.shape)
    # cosine-distributed: points of a sphere that touches the surface
    d = n + sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    off = max(_OFFSET * float(np.ptp(corners.reshape(-1, 3), axis=0).max()), _MIN_OFFSET * size)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
    hit = scene.run((x + off * n).astype(np.float32), d.astype(np.float32))
    return float((hit >= 0).mean())
