"""Independent answers for the hard cases: mpmath for one patch, float64 NumPy for whole shells.

Each works on the float32 arrays that the code under test sees, and shares no line with it. Those of prisms are the library's
own checks of scenes (stability/prisms).
"""

import mpmath
import numpy as np

from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.tracer import Trace
from mesoshell.stability.prisms import invert_prism, prism_point


def as_mp(x: np.ndarray) -> np.ndarray:
    """The same numbers, as 50-digit ones."""
    mpmath.mp.dps = 50
    return np.vectorize(lambda v: mpmath.mpf(float(v)), otypes=[object])(x)


def mp_leave_side(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> tuple[bool, float, float, float]:
    """Whether a ray from 0 leaves through the side (its posts as two rows of p and n), and t, u, h there."""
    d, p, n = as_mp(d), as_mp(p), as_mp(n)
    e, m = p[1] - p[0], n[1] - n[0]
    a, c = d @ np.cross(e, m), d @ np.cross(p[0], n[0])
    b = d @ np.cross(e, n[0]) + d @ np.cross(p[0], m)
    square = b * b - 4 * a * c
    if square < 0 or (a == 0 and b <= 0):
        return False, np.nan, np.nan, np.nan
    u = -c / b if a == 0 else (-b + mpmath.sqrt(square)) / (2 * a)
    foot, post = p[0] + u * e, n[0] + u * m
    across = np.cross(d, post)
    t, h = np.cross(foot, post) @ across / (across @ across), np.cross(foot, d) @ across / (across @ across)
    return bool(0 <= u <= 1 and 0 <= h <= 1), float(t), float(u), float(h)


def mp_leave_cap(d: np.ndarray, corners: np.ndarray) -> tuple[bool, np.ndarray]:
    """Whether a ray from 0 leaves upward through a triangle, and the barycentric coordinates there."""
    d, c = as_mp(d), as_mp(corners)
    weights = np.array([d @ np.cross(c[(k + 1) % 3], c[(k + 2) % 3]) for k in range(3)])
    total = weights.sum()
    if total <= 0:
        return False, np.full(3, np.nan)
    return bool((weights >= 0).all()), (weights / total).astype(float)


def span_of_convex(corners: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter and leave a convex polyhedron of outward triangles (F, 3, 3); enters after leaving: missed."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(axis=(0, 1))
    height = np.einsum("fi,fi->f", normal, corners[:, 0] - centre) - (o - centre) @ normal.T
    speed = d @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = height / speed
    enters = np.max(np.where(speed < 0, t, -np.inf), axis=1)
    leaves = np.min(np.where(speed > 0, t, np.inf), axis=1)
    return enters, leaves


def locate(shell: Shell, x: np.ndarray) -> np.ndarray:
    """Which prisms hold each of the points: (points, prisms), by inverting every prism whose box holds the point."""
    corner = shell.base[shell.faces].astype(np.float64)
    corner = np.concatenate([corner, corner + shell.offset[shell.faces]], axis=1)
    low, high = corner.min(axis=1), corner.max(axis=1)
    point, prism = np.nonzero(((x[:, None] >= low) & (x[:, None] <= high)).all(axis=-1))
    bary, h, off = invert_prism(shell, prism, x[point])
    weights = np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
    held = np.zeros((len(x), len(shell.faces)), bool)
    held[point, prism] = (weights >= 0).all(axis=1) & (h >= 0) & (h <= 1) & (off < 1e-9)
    return held


def total_length(trace: Trace, rays: int) -> np.ndarray:
    """Length of every ray inside the shell."""
    i = trace.intervals
    return np.bincount(i.ray, i.t1 - i.t0, minlength=rays)


def assert_sorted_apart(trace: Trace) -> None:
    """Intervals come by ray, then along it, and none begins before the one before it has ended."""
    i = trace.intervals
    assert (i.t1 >= i.t0).all() and (i.t0 >= 0).all()
    same = i.ray[1:] == i.ray[:-1]
    assert (np.diff(i.ray) >= 0).all()
    assert (i.t0[1:][same] >= i.t1[:-1][same] - 1e-6).all()


def assert_ends_on_ray(trace: Trace, shell: Shell, o: np.ndarray, d: np.ndarray, tolerance: float) -> None:
    """λ and h at both ends of every interval name the point of the ray at that t.

    Where a ray begins within a prism, λ and h at its origin are interpolated, and not compared.
    """
    i = trace.intervals
    for t, bary, h, exact in ((i.t0, i.bary0, i.h0, i.t0 > 0), (i.t1, i.bary1, i.h1, i.t1 > 0)):
        off = np.linalg.norm(prism_point(shell, i.prism, bary, h) - (o[i.ray] + t[:, None] * d[i.ray]), axis=1)
        assert off[exact].max() < tolerance
