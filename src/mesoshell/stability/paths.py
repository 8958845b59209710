"""The path tracer's walk of hard rays, beside that of JAX in float64: the two share no code.

Notation
T           thickness asked for                                                          world
"""

import mesoshell.pathtracer  # noqa: F401  isort: skip  (it makes Mitsuba ready)

import mitsuba as mi
import numpy as np
from jaxtyping import Float

from mesoshell.pathtracer.shells import Shells
from mesoshell.pathtracer.traversal import length
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render.renderer import object_triangles
from mesoshell.shell.render.scene import Scene
from mesoshell.stability.checks import Check
from mesoshell.stability.rays import FAR, NEAR, aim_rays
from mesoshell.stability.walks import OFF

#: Share of rays that may have another length in the shell: where shells overlap, up to 0.15% have (benchmarks/overlaps).
OTHER = 2e-3


def of_walk(scene: Scene, T: float, count: int, rng: np.random.Generator) -> Check:
    """Lengths in the shell of so many rays at vertices, edges and sides, from near and from afar."""
    boundary, shells = (
        Boundary(scene.shell, scene.mesh.faces, others=object_triangles(scene.objects)),
        Shells([scene.shell]),
    )
    off = []
    for distance in (NEAR, FAR):
        rays = aim_rays(scene.shell, count // 2, distance, rng)
        d = rays.d.astype(np.float32).astype(np.float64)
        exact = boundary.trace(rays.o, d, exact=True)
        i = exact.intervals
        off.append((lengths(shells, rays.o, d, exact.end) - np.bincount(i.ray, i.t1 - i.t0, len(d))) / T)
    off = np.concatenate(off)
    other, shorter = int((~(np.abs(off) <= OFF)).sum()), int((off < -OFF).sum())  # NaN is another
    line = f"{shorter} of {len(off)} rays are shorter in the shell than in JAX's float64 walk, {other - shorter} longer"
    share = other / len(off)
    return Check("paths", f"{line}, by over {OFF:g} of the thickness", share, OTHER)


def lengths(
    shells: Shells, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"], end: Float[np.ndarray, "R"]
) -> Float[np.ndarray, "R"]:
    """Of rays in shells, which begin outside of them, up to their ends."""
    vector = lambda x: mi.Vector3d(np.ascontiguousarray(x.T))  # noqa: E731
    return np.array(length(shells, vector(o), vector(d), mi.Float64(end)))
