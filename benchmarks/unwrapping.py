"""What it costs to make a mesh without texture coordinates ready: python -m benchmarks.unwrapping MESH

xatlas on the mesh as a whole and in parts (geometry/unwrap): seconds, charts, the deviation of the texture's scale (of its
mean), the length of seams in mean edges, and how full the texture is. Then the set-up of a render on a fresh cache, and once
more, each in a process of its own.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from unittest import mock

import numpy as np

from mesoshell.geometry import unwrap as unwrapping
from mesoshell.geometry.mesh import Mesh, load_mesh
from mesoshell.geometry.topology import pair_edges

SET_UP = """
import sys
import mesoshell as ms
from mesoshell.render.quality import PRESETS
from mesoshell.scene.prepare import prepare
print(prepare(ms.Scene(sys.argv[1], ms.load_material("turf")), PRESETS["normal"]).setup)
"""


def measured(mesh: Mesh) -> tuple[float, int, float, float, float]:
    """Seconds, charts, deviation of the scale, length of seams, share of the square."""
    begin = time.perf_counter()
    uv, charts = unwrapping.unwrap(mesh.vertices, mesh.faces)
    seconds = time.perf_counter() - begin
    P, U = mesh.vertices[mesh.faces].astype(np.float64), uv.astype(np.float64)
    area = np.linalg.norm(np.cross(P[:, 1] - P[:, 0], P[:, 2] - P[:, 0]), axis=1)
    p, q = U[:, 1] - U[:, 0], U[:, 2] - U[:, 0]
    flat = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    scale = np.sqrt(flat / area)
    mean = np.average(scale, weights=area)
    deviation = np.sqrt(np.average((scale / mean - 1) ** 2, weights=area))
    edges = pair_edges(mesh.faces)
    own = np.flatnonzero(edges.opposed.ravel())
    other = edges.partner.ravel()[own]
    here = U[own // 3, own % 3], U[own // 3, (own % 3 + 1) % 3]
    there = U[other // 3, (other % 3 + 1) % 3], U[other // 3, other % 3]
    apart = (np.abs(np.subtract(here, there)) > 1e-5).any(axis=(0, 2))
    length = np.linalg.norm(np.roll(P, -1, axis=1) - P, axis=-1)
    return seconds, charts, deviation, length.ravel()[own][apart].sum() / 2 / length.mean(), flat.sum() / 2


def set_up(path: str, cache: str) -> float:
    """Seconds of set-up in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", SET_UP, path],
        env=os.environ | {"XDG_CACHE_HOME": cache},
        capture_output=True,
        check=True,
    )
    return float(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh")
    path = parser.parse_args().mesh
    mesh = load_mesh(path)
    print(f"{len(mesh.faces)} faces; {'seconds':>20} {'charts':>7} {'scale ±':>8} {'seams':>7} {'full':>5}")
    for name, part in (("whole", 10**9), (f"parts of {unwrapping.PART}", unwrapping.PART)):
        with mock.patch.object(unwrapping, "PART", part):
            seconds, charts, deviation, seams, full = measured(mesh)
        print(f"{name:<20} {seconds:13.1f} {charts:7d} {deviation:8.3f} {seams:7.0f} {full:5.2f}")
    with tempfile.TemporaryDirectory() as cache:
        print(f"set-up: {set_up(path, cache):.2f} s, and again {set_up(path, cache):.2f} s")


if __name__ == "__main__":
    main()
