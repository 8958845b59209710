"""Texture coordinates for a mesh without any, by xatlas.

Notation
uv      corner coordinates in the unit square, one scale in u and v, charts apart and none mirrored
edge    mean edge length; xatlas sees the mesh in this unit, about its centre, because it takes areas below 1e-7 as zero

xatlas (0.0.11) can crash on some finely and evenly tessellated smooth surfaces (a sphere of 80 000 triangles). So it runs
in a process of its own, which Ctrl-C stops too. If it crashes, it runs again with each vertex moved by JITTER edges, which
bends the charts' outlines only a little; if that fails too, the mesh needs UVs.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import xatlas
from jaxtyping import Float, Int

from mesoshell.errors import InputError

JITTER = 0.03


def unwrap(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], source: str = "mesh"
) -> tuple[Float[np.ndarray, "F 3 2"], int]:
    """Corner UVs (float32) and the number of charts. Raises InputError(source, ...) if xatlas fails."""
    points = vertices.astype(np.float64)
    edge = np.linalg.norm(np.roll(points[faces], -1, axis=1) - points[faces], axis=-1).mean()
    points = (points - points.mean(axis=0)) / edge
    for jitter in (0.0, JITTER):
        moved = points + jitter * np.random.default_rng(0).normal(size=points.shape)
        unwrapped = _in_child(moved.astype(np.float32), faces.astype(np.uint32))
        if unwrapped is not None and np.isfinite(unwrapped[0]).all():
            return unwrapped
    raise InputError(source, "has no usable UVs, and xatlas cannot unwrap it: give it UVs")


def _in_child(vertices: np.ndarray, faces: np.ndarray) -> tuple[Float[np.ndarray, "F 3 2"], int] | None:
    with TemporaryDirectory() as folder:
        np.savez(Path(folder) / "mesh.npz", vertices=vertices, faces=faces)
        child = subprocess.run([sys.executable, "-m", __name__, folder], capture_output=True)
        if child.returncode != 0:
            return None
        with np.load(Path(folder) / "uv.npz") as made:
            return made["uv"], int(made["charts"])


def _run_xatlas(folder: Path) -> None:
    chart, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    chart.fix_winding = True
    pack.rotate_charts = False  # it rotates by exchanging u and v, which mirrors
    atlas = xatlas.Atlas()
    with np.load(folder / "mesh.npz") as mesh:
        atlas.add_mesh(mesh["vertices"], mesh["faces"])
    atlas.generate(chart, pack)
    _, corner, uv = atlas[0]
    size = np.array([atlas.width, atlas.height], np.float64)
    np.savez(folder / "uv.npz", uv=(uv[corner] * (size / size.max())).astype(np.float32), charts=atlas.chart_count)


if __name__ == "__main__":
    _run_xatlas(Path(sys.argv[1]))
