"""Shells as tables: prisms, and their boundary triangles in a separate scene (shell/geometry/tracer, in Mitsuba).

Notation
code        of a triangle: 0, 1, 2: part of the tetrahedron around that side, at a border; 3: the top; 4: the base
shell       index of the shell that a prism belongs to

All shells of a scene share one set of tables. The boundary is kept apart from the user's scene: no ray of the user's scene
meets it, no emitter is drawn on it, and no BSDF is looked up there. Rays meet it in float32, so it is stored relative to its
centre: rounding errors grow with the size of the shells and a ray's distance from them, not with their distance from the
origin. (The tables hold the mesh's own float32 numbers, from which the walk goes on in float64.)
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.pathtracer.prism import BASE, TOP
from mesoshell.shell.geometry.extrude import TETRAHEDRON, Shell


class Shells:
    """corners: (P · 6, 3); across, across_edge: (P · 3); uv: (P · 3, 2), patches; shell: (P); prism, code: of each triangle.

    box: least and greatest coordinates of all shells, (2, 3), world; centre: its middle, where the boundary's scene has its
    origin; size: its greatest side. Kernels read these: as constants they would be compiled anew for each scene.
    """

    def __init__(self, shells: list[Shell]):
        parts = [_tables(s) for s in shells]
        first = np.cumsum([0, *(len(s.faces) for s in shells[:-1])])
        across = np.concatenate(
            [np.where(s.neighbour < 0, -1, s.neighbour + a) for s, a in zip(shells, first, strict=True)]
        )
        self.corners = mi.Float(np.concatenate([p[0] for p in parts]).ravel())
        self.across = mi.Int32(across.ravel().astype(np.int32))
        self.across_edge = mi.UInt32(np.concatenate([np.maximum(s.neighbour_edge, 0) for s in shells]).ravel())
        self.uv = mi.Float(np.concatenate([s.uv for s in shells]).ravel())
        self.shell = mi.UInt32(np.repeat(np.arange(len(shells)), [len(s.faces) for s in shells]))
        self.prism = mi.UInt32(np.concatenate([p[2] + a for p, a in zip(parts, first, strict=True)]))
        self.code = mi.UInt32(np.concatenate([p[3] for p in parts]))
        triangles = np.concatenate([p[1] for p in parts])
        self.box = np.stack([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
        self.size = dr.opaque(mi.Float64, float((self.box[1] - self.box[0]).max()))
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        self.normal = mi.Float64(normal.ravel())
        self.point = mi.Float64(triangles[:, 0].ravel())
        centre = self.box.mean(axis=0)
        self.centre = mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in centre))
        self.scene = scene_of(triangles - centre)

    def frame(self, prism):
        """Posts and base points of a prism in float32, and its corners' (u, v)."""
        rows = [dr.gather(mi.Vector3f, self.corners, prism * 6 + k) for k in range(6)]
        uv = [dr.gather(mi.Vector2f, self.uv, prism * 3 + k) for k in range(3)]
        return rows[:3], rows[3:], uv


def scene_of(triangles: np.ndarray) -> Any:
    """The triangles (T, 3, 3) in a separate scene. Without Embree's robust mode, one in 80 rays aimed at an edge or a vertex
    passes between the triangles that share it."""
    parts: dict[str, Any] = {"type": "scene", "boundary": _boundary(triangles)}
    if not str(mi.variant()).startswith("cuda"):
        parts["embree_use_robust_intersections"] = True
    return mi.load_dict(parts)


def _boundary(triangles: np.ndarray) -> mi.Mesh:
    """A mesh without shared vertices: a triangle's index is its row in the tables."""
    mesh = mi.Mesh("boundary", 3 * len(triangles), len(triangles))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(triangles.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.arange(3 * len(triangles), dtype=np.uint32))
    parameters.update()
    return mesh


def _tables(s: Shell) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners of prisms; triangles (T, 3, 3), float64, and the prism and the code of each."""
    foot = s.base.astype(np.float64)
    top, face = foot + s.offset, np.arange(len(s.faces))
    p, k = np.nonzero(s.neighbour < 0)
    ends = np.stack([s.faces[p, k], s.faces[p, (k + 1) % 3]], axis=1)
    sides = np.concatenate([foot[ends], top[ends][:, ::-1]], axis=1)[:, TETRAHEDRON].reshape(-1, 3, 3)
    triangles = np.concatenate([top[s.faces], foot[s.faces], sides])
    prism = np.concatenate([face, face, np.repeat(p, 4)])
    code = np.concatenate([np.full(len(face), TOP), np.full(len(face), BASE), np.repeat(k, 4)])
    corners = np.concatenate([s.base[s.faces], s.offset[s.faces]], axis=1)
    return corners.astype(np.float32), triangles, prism.astype(np.uint32), code.astype(np.uint32)
