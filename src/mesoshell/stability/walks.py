"""Walks of hard rays through a shell, judged by oracles in float64 that share no code with the walk; and, for what its float32
changes, by the walk itself in float64.

Notation
T           thickness asked for: the unit of lengths here                                        world
excess      of each prism: the worst place of edges, prisms, crossings and precision, over what one may be off       (P,)
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.tracer import Boundary, Trace
from mesoshell.shell.render.renderer import object_triangles
from mesoshell.shell.render.scene import Scene
from mesoshell.stability import rays as of
from mesoshell.stability.checks import Check
from mesoshell.stability.prisms import invert_prism, prism_point
from mesoshell.stability.rays import Rays

#: Of rays aimed at vertices and edges, those that may leak; of their intervals, those that may lie in a neighbour of their
#: prism: a ray that goes through a vertex itself belongs to all prisms there.
LEAKS, ASTRAY = 2e-5, 1e-4
#: How far places may be off, in T; a middle outside its prism, in λ and h; what Embree rounds, in sizes of the scene; what else
#: may lie between a point and an interval, in T.
OFF, OUTSIDE, SHIFT, NEXT = 1e-3, 1e-3, 3e-7, 1e-4
#: Intervals of a kind of rays whose middles are inverted, at most; Newton's steps, from the interval's own λ and h.
INVERTED, STEPS = 20_000, 8
#: Shares of the rays that are aimed: from near, from far, at the front of the surface, grazing the top at ANGLE (radians).
NEAR, FAR, FRONT, GRAZING, ANGLE = 0.5, 0.2, 0.25, 0.05, 1e-3


class Walks(NamedTuple):
    """What was found. first: the prism that each pixel of the camera sees, −1 for none."""

    checks: list[Check]
    first: Int[np.ndarray, "H W"]
    excess: Float[np.ndarray, "P"]


class Walked(NamedTuple):
    """Rays of one kind, what they meet, and what they meet if all is walked in float64."""

    rays: Rays
    trace: Trace
    exact: Trace


class Middles(NamedTuple):
    """Middles of intervals: how far, in λ or h, they lie outside the prism; how far their interpolated place is off, in T."""

    prism: Int[np.ndarray, "I"]
    outside: Float[np.ndarray, "I"]
    off: Float[np.ndarray, "I"]


def walk_through(
    scene: Scene, T: float, count: int, rng: np.random.Generator, progress: Callable[[float], None]
) -> Walks:
    """Walk rays of the camera, and so many that are aimed, through the scene's shell."""
    shell, camera = scene.shell, scene.camera
    boundary = Boundary(shell, scene.mesh.faces, others=object_triangles(scene.objects))
    kinds = {
        "camera": of.of_camera(camera, np.arange(camera.width * camera.height), rng),
        "near": of.aim_rays(shell, int(NEAR * count), of.NEAR, rng),
        "far": of.aim_rays(shell, int(FAR * count), of.FAR, rng),
        "front": of.at_the_front(scene.mesh, int(FRONT * count), rng),
        "grazing": of.grazing(shell, int(GRAZING * count), ANGLE, rng),
    }
    many: dict[str, Walked] = {}
    for done, (name, some) in enumerate(kinds.items(), start=1):
        many[name] = Walked(some, boundary.trace(some.o, some.d), boundary.trace(some.o, some.d, exact=True))
        progress(done / len(kinds))
    excess = np.zeros(len(shell.faces))
    sharp = [walked for name, walked in many.items() if name != "grazing"]
    inverted = [middles(shell, walked, T, rng) for walked in many.values()]
    near = NEXT * T + SHIFT * boundary.size
    checks = [
        _of_edges([many["near"], many["far"]], near, excess),
        _of_surface(many["front"], near),
        _of_prisms(inverted, excess),
        _of_joins(shell, many.values(), T, excess),
        _of_precision(sharp, many["camera"], T, excess),
        _of_grazing(shell, many["grazing"], T),
        _of_coordinates(inverted[0]),
    ]
    first = np.full(camera.width * camera.height, -1)
    intervals = many["camera"].trace.intervals
    first[intervals.ray[::-1]] = intervals.prism[::-1]
    return Walks(checks, first.reshape(camera.height, camera.width), excess)


def leaks(walked: Walked, near: float) -> Bool[np.ndarray, "R"]:
    """Rays that do not meet the shell at a point that is known to lie in it, and that they reach. near: how far is there."""
    reach, i = walked.rays.reach, walked.trace.intervals
    met = np.zeros(len(reach), bool)
    met[i.ray[(i.t0 - near <= reach[i.ray]) & (reach[i.ray] <= i.t1 + near)]] = True
    return np.isfinite(reach) & (walked.trace.end > reach + near) & ~met


def passing(walked: Walked, near: float) -> Bool[np.ndarray, "R"]:
    """Rays that pass a point of the surface which they meet from the front. near: how far is there."""
    return walked.trace.end > walked.rays.surface + near


def joins(shell: Shell, walked: Walked, T: float) -> tuple[Int[np.ndarray, "I"], Float[np.ndarray, "I"]]:
    """Prisms that rays leave for a neighbour, and how far λ and h on either side are from the ray, in T. (Where a surface or
    another shell cuts an interval, they are interpolated.)"""
    i, rays = walked.trace.intervals, walked.rays
    next_door = (shell.neighbour[i.prism[:-1]] == i.prism[1:, None]).any(axis=1)
    on = np.flatnonzero(next_door & (i.ray[1:] == i.ray[:-1]) & (i.t1[:-1] == i.t0[1:]))
    x, after = rays.o[i.ray[on]] + i.t1[on, None] * rays.d[i.ray[on]], on + 1
    left = np.linalg.norm(prism_point(shell, i.prism[on], i.bary1[on], i.h1[on]) - x, axis=1)
    entered = np.linalg.norm(prism_point(shell, i.prism[after], i.bary0[after], i.h0[after]) - x, axis=1)
    return i.prism[on], np.maximum(left, entered) / T


def middles(shell: Shell, walked: Walked, T: float, rng: np.random.Generator) -> Middles:
    """The middles of at most INVERTED intervals, at random."""
    rays, every = walked.rays, walked.trace.intervals
    chosen = rng.permutation(len(every.ray))[:INVERTED]
    i = Intervals(*(x[chosen] for x in every))
    bary, h = (i.bary0 + i.bary1) / 2, (i.h0 + i.h1) / 2
    x = rays.o[i.ray] + ((i.t0 + i.t1) / 2)[:, None] * rays.d[i.ray]
    exact, height, left = invert_prism(shell, i.prism, x, (bary, h), STEPS)
    least = np.minimum(np.minimum(exact.min(axis=1), 1 - exact.sum(axis=1)), np.minimum(height, 1 - height))
    off = np.linalg.norm(prism_point(shell, i.prism, bary, h) - x, axis=1) / T
    return Middles(i.prism, np.where(left < OFF * T, np.maximum(-least, 0), np.inf), off)


def differences(walked: Walked, T: float) -> Float[np.ndarray, "R"]:
    """How far each ray's lengths in the shell, in both precisions, are apart, in T: up to where the first of them ends, since a
    ray that touches the surface at a vertex may end there or not."""
    end = np.minimum(walked.trace.end, walked.exact.end)

    def length(i: Intervals) -> np.ndarray:
        return np.bincount(i.ray, np.maximum(np.minimum(i.t1, end[i.ray]) - i.t0, 0), len(end))

    return np.abs(length(walked.trace.intervals) - length(walked.exact.intervals)) / T


def _of_edges(aimed: list[Walked], near: float, excess: np.ndarray) -> Check:
    leaking = [leaks(walked, near) for walked in aimed]
    for walked, which in zip(aimed, leaking, strict=True):
        _raise(excess, walked.rays.prism[which], 1 / OFF)
    count, tried = sum(x.sum() for x in leaking), sum(np.isfinite(walked.rays.reach).sum() for walked in aimed)
    line = f"{count} of {tried} rays at posts and sides that prisms share miss the shell there, from near or from afar"
    return rare("edges", line, count, tried, LEAKS)


def _of_surface(front: Walked, near: float) -> Check:
    through = passing(front, near)
    line = f"{through.sum()} of {len(through)} rays at the front of its vertices and edges go through the surface"
    return rare("surface", line, through.sum(), len(through), LEAKS)


def _of_prisms(inverted: list[Middles], excess: np.ndarray) -> Check:
    for some in inverted:
        _raise(excess, some.prism, some.outside / OUTSIDE)
    outside = np.concatenate([some.outside for some in inverted])
    astray, worst = (~(outside <= OUTSIDE)).sum(), outside.max(initial=0)
    line = f"{astray} of {len(outside)} intervals lie in a neighbour of their prism (worst λ or h: {worst:.1g} outside)"
    return rare("prisms", line, astray, len(outside), ASTRAY)


def _of_joins(shell: Shell, many: Iterable[Walked], T: float, excess: np.ndarray) -> Check:
    worst, count = 0.0, 0
    for walked in many:
        prism, off = joins(shell, walked, T)
        _raise(excess, prism, off / OFF)
        worst, count = float(np.maximum(worst, off.max(initial=0))), count + len(off)
    line = f"{count} places, from prism to prism, are off by {worst:.1g} of the thickness at most"
    return Check("crossings", line, worst, OFF)


def _of_precision(sharp: list[Walked], camera: Walked, T: float, excess: np.ndarray) -> Check:
    worst = 0.0
    for walked in sharp:
        off, i = differences(walked, T), walked.trace.intervals
        _raise(excess, i.prism, off[i.ray] / OFF)
        worst = float(np.maximum(worst, off.max(initial=0)))
    again = camera.trace.redone / max(camera.trace.walked, 1)
    line = f"float32 changes lengths in the shell by {worst:.1g} of the thickness at most"
    return Check("precision", f"{line}; {again:.2%} of the camera's walks are redone in float64", worst, OFF)


def _of_grazing(shell: Shell, grazing: Walked, T: float) -> Check:
    """Such a ray runs along faces, on which places are good to OFF of their width."""
    corner = shell.base[shell.faces].astype(np.float64)
    width = float(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean())
    off = differences(grazing, T).max(initial=0)
    line = f"float32 changes rays at {ANGLE:g} to the top by {off:.1g} of the thickness at most"
    return Check("grazing", line, float(off), OFF * max(1.0, width / T))


def _of_coordinates(camera: Middles) -> Check:
    """What the paper's interpolation of coordinates costs, of the camera's rays."""
    if not len(camera.off):
        return Check("coordinates", "the camera does not see the shell", 0.0, None)
    usual, most = np.quantile(camera.off, (0.5, 0.99))
    line = f"interpolated ones are off by {usual:.1g} of the thickness (median), {most:.1g} at the 99th percentile"
    return Check("coordinates", line + (": consider coordinates=exact" if most > 0.05 else ""), most, None)


def rare(name: str, line: str, count: int | np.integer, tried: int | np.integer, most: float) -> Check:
    """A check on a share, of which one may always be lost."""
    tried = max(int(tried), 1)
    return Check(name, line, int(count) / tried, max(most, 1 / tried))


def _raise(excess: np.ndarray, prism: Int[np.ndarray, "N"], value: Float[np.ndarray, "N"] | float) -> None:
    np.maximum.at(excess, prism, np.nan_to_num(value, nan=np.inf))
