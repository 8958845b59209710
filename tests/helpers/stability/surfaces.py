"""Small meshes for the hard cases, and rays at them."""

import numpy as np
import trimesh

from mesoshell.geometry.mesh import Mesh, check_mesh


def plain(points: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh whose every triangle covers the same half of the UV square."""
    return check_mesh(points, faces, np.tile([[0.0, 0], [1, 0], [0, 1]], (len(faces), 1, 1)), "mesh")


def ball(subdivisions: int = 2, radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """A convex polyhedron of 20 · 4^subdivisions triangles."""
    made = trimesh.creation.icosphere(subdivisions, radius)
    return plain(np.asarray(made.vertices) + np.array(centre), np.asarray(made.faces))


def torus() -> Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12)
    return plain(np.asarray(made.vertices), np.asarray(made.faces))


def together(*meshes: Mesh) -> Mesh:
    """Separate parts as one mesh."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    faces = np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)])
    return plain(np.concatenate([m.vertices for m in meshes]), faces)


def sheet(height, side: int = 9) -> Mesh:
    """The graph z = height(x, y) over [-1, 1]², grown upward; (u, v) = (x, y)."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    i = np.arange(side * side).reshape(side, side)
    a, b, c, d = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return check_mesh(points, faces, points[faces][..., :2], "sheet")


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def rays_at(targets: np.ndarray, distance: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One ray at each target, from a random point at a distance from it."""
    d = unit(rng.normal(size=targets.shape))
    o = targets - distance * d
    return o, unit(targets - o)
