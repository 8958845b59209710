"""Texture coordinates for a mesh without any, by xatlas.

Notation
uv      corner coordinates in the unit square, one scale in u and v, charts apart and none mirrored
edge    mean edge length; xatlas sees the mesh in this unit, about its centre, because it takes areas below 1e-7 as zero

xatlas (0.0.11) can crash on some finely and evenly tessellated smooth surfaces (a sphere of 80 000 triangles). So it runs
in a process of its own, which Ctrl-C stops too. If it crashes, it runs again with each vertex moved by JITTER edges, which
bends the charts' outlines only a little; if that fails too, the mesh needs UVs.

xatlas grows charts one by one over a connected surface, which takes more than in proportion to its size, and by one thread.
So a large mesh is cut into parts of about PART faces that lie together (k-means of their centres), whose charts grow side by
side and are packed into one atlas (docs/results/performance.md).
"""

import subprocess
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float, Int

from mesoshell.errors import InputError

JITTER = 0.03
PART, ROUNDS = 5000, 10


def unwrap(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], source: str = "mesh"
) -> tuple[Float[np.ndarray, "F 3 2"], int]:
    """Corner UVs (float32) and the number of charts. Raises InputError(source, ...) if xatlas fails."""
    points = vertices.astype(np.float64)
    edge = np.linalg.norm(np.roll(points[faces], -1, axis=1) - points[faces], axis=-1).mean()
    points = (points - points.mean(axis=0)) / edge
    parts = parts_of(points[faces].mean(axis=1))
    for jitter in (0.0, JITTER):
        moved = points + jitter * np.random.default_rng(0).normal(size=points.shape)
        unwrapped = _in_child(moved.astype(np.float32), faces.astype(np.uint32), parts)
        if unwrapped is not None and np.isfinite(unwrapped[0]).all():
            return unwrapped
    raise InputError(source, "has no usable UVs, and xatlas cannot unwrap it: give it UVs")


def parts_of(centres: Float[np.ndarray, "F 3"]) -> Int[np.ndarray, "F"]:
    """Which part each face belongs to: faces that lie together, about PART of them."""
    count = len(centres) // PART
    if count < 2:
        return np.zeros(len(centres), np.int64)
    from scipy.cluster.vq import kmeans2  # which takes as long to import as small meshes to unwrap

    begin = centres[np.random.default_rng(0).choice(len(centres), count, replace=False)]
    with warnings.catch_warnings(action="ignore"):  # that a part is empty
        return kmeans2(centres, begin, iter=ROUNDS, minit="matrix")[1].astype(np.int64)


def _in_child(
    vertices: np.ndarray, faces: np.ndarray, parts: np.ndarray
) -> tuple[Float[np.ndarray, "F 3 2"], int] | None:
    with TemporaryDirectory() as folder:
        np.savez(Path(folder) / "mesh.npz", vertices=vertices, faces=faces, parts=parts)
        child = subprocess.run(
            [sys.executable, "-P", "-m", "mesoshell.geometry.xatlas_process", folder], capture_output=True
        )
        if child.returncode != 0:
            return None
        with np.load(Path(folder) / "uv.npz") as made:
            return made["uv"], int(made["charts"])
