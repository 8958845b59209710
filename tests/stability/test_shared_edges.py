"""Hard case 4: rays aimed exactly at vertices, posts and edges that prisms share: one owner, and no leak.

The oracle clips rays by the faces' planes in float64: both surfaces of a ball's shell are convex polyhedra. A ray
leaks if it passes through the base surface, or if its length inside the shell is wrong by 1e-4 of the ball.
"""

import numpy as np
import pytest
from oracles import assert_sorted_apart, span_of_convex, total_length
from surfaces import ball, rays_at

from mesoshell.shell.geometry.extrude import Shell, extrude
from mesoshell.shell.geometry.tracer import Boundary

PART = 10000  # rays at a time: the oracle holds a number for each ray and face
FAR = (148376.0, 1234.0, -223423.0)


def targets(shell: Shell, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points in equal parts on vertices, posts, edges of the base and of the top, and sides."""
    base, post = shell.base.astype(np.float64), shell.offset.astype(np.float64)
    kind = np.arange(count) % 5
    face, k = rng.integers(0, len(shell.faces), count), rng.integers(0, 3, count)
    i, j = shell.faces[face, k], shell.faces[face, (k + 1) % 3]
    u = np.where(kind < 2, 0, rng.uniform(size=count))[:, None]
    h = np.select([kind == 0, kind == 2, kind == 3], [np.arange(count) // 5 % 2, 0, 1], rng.uniform(size=count))[
        :, None
    ]
    return (1 - u) * (base[i] + h * post[i]) + u * (base[j] + h * post[j])


def leaks(radius: float, centre: tuple[float, float, float], count: int, tolerance: float) -> np.ndarray:
    """How many rays leak, and how many were compared (a ray that only touches the base may end there or not)."""
    mesh = ball(2, radius, centre)
    shell = extrude(mesh, 0.2 * radius, radius)
    boundary = Boundary(shell, mesh.faces)
    rng = np.random.default_rng(5)
    wrong = compared = 0
    for part in range(0, count, PART):
        size = min(PART, count - part)
        o, d = rays_at(targets(shell, size, rng), 3 * radius, rng)
        trace = boundary.trace(o, d)
        assert_sorted_apart(trace)
        enters, leaves = span_of_convex((shell.base.astype(np.float64) + shell.offset)[shell.faces], o, d)
        base = span_of_convex(shell.base[shell.faces].astype(np.float64), o, d)
        blocked = base[1] - base[0] > 0
        enters, leaves = np.maximum(enters, 0), np.where(blocked, base[0], leaves)
        clear = np.abs(base[1] - base[0]) > 1e-3 * radius
        off = np.abs(total_length(trace, size) - np.maximum(leaves - enters, 0)) > tolerance * radius
        wrong += (clear & (off | (blocked != np.isfinite(trace.end)))).sum()
        compared += clear.sum()
    assert compared > 0.9 * count
    return np.array([wrong, compared])


def test_no_leak():
    assert leaks(1.0, (0, 0, 0), 20000, 1e-4)[0] == 0


@pytest.mark.slow
def test_no_leak_in_a_million_rays():
    assert leaks(1.0, (0, 0, 0), 1_000_000, 1e-4)[0] == 0


def test_few_leaks_far_from_the_origin():
    wrong, compared = leaks(16.0, FAR, 20000, 1e-4)
    assert wrong <= 2e-5 * compared


@pytest.mark.slow
def test_few_leaks_far_from_the_origin_in_a_million_rays():
    wrong, compared = leaks(16.0, FAR, 1_000_000, 1e-4)
    assert wrong <= 2e-5 * compared
