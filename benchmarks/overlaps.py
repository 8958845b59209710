"""What the path tracer loses where shells overlap: python -m benchmarks.overlaps [--rays 20000]

Rays aimed at vertices, posts, edges and sides, from near and far: the share whose way through the shell is shorter or longer
than that of the JAX engine by over a thousandth of the thickness.
"""

import argparse
from pathlib import Path

import numpy as np

from mesoshell.geometry.mesh import load_mesh
from mesoshell.pathtracer.shells import Shells
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.stability.paths import lengths
from mesoshell.stability.rays import FAR, NEAR, aim_rays

SCENES = (("spot", 0.06), ("suzanne", 0.1), ("suzanne", 0.3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=20_000)
    count = parser.parse_args().rays
    print("| mesh | thickness | from, sizes | shorter | longer |")
    print("|---|---|---|---|---|")
    for name, thickness in SCENES:
        mesh = load_mesh(Path("tests/data") / f"{name}.obj")
        shell = extrude(mesh, thickness, thickness)
        for distance in (NEAR, FAR):
            rays = aim_rays(shell, count, distance, np.random.default_rng(7))
            d = rays.d.astype(np.float32).astype(np.float64)
            true = Boundary(shell, mesh.faces).trace(rays.o, d)
            i = true.intervals
            off = lengths(Shells([shell]), rays.o, d, true.end) - np.bincount(i.ray, i.t1 - i.t0, count)
            off /= thickness
            shorter, longer = (off < -1e-3).mean(), (off > 1e-3).mean()
            print(f"| `{name}.obj` | {thickness} | {distance:.0f} | {shorter:.3%} | {longer:.3%} |")


if __name__ == "__main__":
    main()
