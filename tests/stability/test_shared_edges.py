"""Hard case 4: rays aimed exactly at vertices, posts and edges that prisms share: one owner, and no leak.

The oracle clips rays by the faces' planes in float64: both surfaces of a ball's shell are convex polyhedra. A ray
leaks if it passes through the base surface, or if its length inside the shell is wrong by 1e-4 of the ball.
"""

import numpy as np
import pytest

from mesoshell.shell.geometry import tracer
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers.stability.hard_rays import FAR, PART, targets
from tests.helpers.stability.oracles import assert_sorted_apart, span_of_convex, total_length
from tests.helpers.stability.surfaces import ball, rays_at, unit


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


@pytest.mark.parametrize(("radius", "centre"), [(1.0, (0, 0, 0)), (16.0, FAR)])
def test_rays_beside_an_edge_are_given_their_triangle_in_float64(
    radius: float, centre: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch
):
    """Only those so near that float32 could err are looked at again, and nothing changes if all are: rays at edges, and beside
    them by up to twice what is looked at."""
    mesh = ball(4, radius, centre)
    shell = extrude(mesh, 0.01 * radius, radius)
    boundary, rng = Boundary(shell, mesh.faces), np.random.default_rng(7)
    place = targets(shell, 20000, rng)
    away = (
        tracer.BESIDE * boundary.radius * rng.uniform(0, 2, (len(place), 1)) * (np.arange(len(place)) % 4 > 0)[:, None]
    )
    o, d = rays_at(place + away * unit(rng.normal(size=place.shape)), 1.05 * radius, rng)
    met = {}
    for beside in (0.0, tracer.BESIDE, np.inf):
        monkeypatch.setattr(tracer, "BESIDE", beside)
        met[beside] = boundary.first_hit(o, d)
    few, checked, all_ = met.values()
    np.testing.assert_array_equal(checked[0], all_[0])
    np.testing.assert_array_equal(checked[1], all_[1])
    assert (few[0] != all_[0]).any()


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
