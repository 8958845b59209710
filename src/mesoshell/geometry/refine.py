"""Finer triangles of the same mesh, on which an image over its UV square can be read (NumPy only).

Notation
level       each halves all edges: a triangle becomes four, which lie in it
image       (H, W) over the UV square, whose first row has v = 1; repeated where texture coordinates leave the square
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh

#: Most triangles that a mesh is refined to, and the length of an edge that is fine enough, pixels of the image.
MAX_FACES, PIXELS = 2**17, 2.0
#: Share of triangles that may be without an area; how far texture coordinates lie outside of the square by rounding alone.
FLAT, OUTSIDE = 1e-3, 1e-4


def refine(mesh: Mesh, levels: int) -> Mesh:
    """Triangles halved so many times along each edge, fewer if single precision would leave more than FLAT of them without
    an area; normals and texture coordinates are interpolated."""
    for _ in range(levels):
        fine = _halved(mesh)
        corner = fine.vertices[fine.faces]
        if (_areas(corner) == 0).mean() > FLAT:
            break
        mesh = fine
    return mesh


def pixels_an_edge(mesh: Mesh, shape: tuple[int, int]) -> float:
    """The longest edge on an image of this shape."""
    edges = np.abs(np.roll(mesh.uv, -1, axis=1) - mesh.uv).astype(np.float64) * np.array([shape[1], shape[0]])
    return float(edges.max())


def levels_for(mesh: Mesh, shape: tuple[int, int]) -> int:
    """Levels until edges are short enough to show an image of this shape, as far as MAX_FACES allows."""
    wanted = int(np.ceil(np.log2(np.clip(pixels_an_edge(mesh, shape) / PIXELS, 1.0, 1e9))))
    return max(0, min(wanted, int(np.log2(MAX_FACES / len(mesh.faces)) / 2)))


def at_vertices(mesh: Mesh, image: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "V"]:
    """An image at each vertex, interpolated between pixels: the mean over its corners, which differ at seams. It ends at the
    square's borders, or goes round where texture coordinates leave it."""
    uv = mesh.uv.astype(np.float64)
    around = uv.min() < -OUTSIDE or uv.max() > 1 + OUTSIDE
    height, width = image.shape
    x, y = uv[..., 0] * width - 0.5, (1 - uv[..., 1]) * height - 0.5
    if not around:
        x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    f, g = x - i, y - j
    i, right, j, below = i % width, (i + 1) % width, j % height, (j + 1) % height
    corner = (1 - g) * ((1 - f) * image[j, i] + f * image[j, right])
    corner += g * ((1 - f) * image[below, i] + f * image[below, right])
    count = len(mesh.vertices)
    total = np.bincount(mesh.faces.ravel(), corner.ravel(), count)
    return total / np.maximum(np.bincount(mesh.faces.ravel(), minlength=count), 1)


def _areas(corner: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F"]:
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).astype(np.float64), axis=1)


def _halved(mesh: Mesh) -> Mesh:
    faces, count = mesh.faces.astype(np.int64), len(mesh.vertices)
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    edges, middle = np.unique(ends, axis=0, return_inverse=True)
    a, b, c = faces.T
    ab, bc, ca = (count + middle.reshape(-1, 3)).T
    inner = mesh.normals[edges].astype(np.float64).sum(axis=1)
    inner /= np.maximum(np.linalg.norm(inner, axis=1, keepdims=True), 1e-30)
    points = mesh.vertices[edges].astype(np.float64).mean(axis=1)
    half = (mesh.uv + np.roll(mesh.uv, -1, axis=1)) / 2
    (u, v, w), (uv, vw, wu) = np.moveaxis(mesh.uv, 1, 0), np.moveaxis(half, 1, 0)

    def four(p, q, r, pq, qr, rp) -> np.ndarray:
        parts = [(p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]
        return np.stack([np.stack(part, axis=1) for part in parts], axis=1)

    return replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, points.astype(np.float32)]),
        faces=four(a, b, c, ab, bc, ca).reshape(-1, 3).astype(np.int32),
        uv=four(u, v, w, uv, vw, wu).reshape(-1, 3, 2).astype(np.float32),
        normals=np.concatenate([mesh.normals, inner.astype(np.float32)]),
    )
