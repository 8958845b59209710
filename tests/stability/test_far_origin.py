"""Hard case 3: the scene at an offset of 1e3 to 1e5; the oracles are mpmath for a side and float64 for a whole shell.

Both take the float32 vertices as they come out of rounding at that offset: what is tested is that nothing more is lost.
"""

import numpy as np
import pytest

from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers.stability.hard_rays import OFFSETS, TOWARD
from tests.helpers.stability.oracles import (
    assert_ends_on_ray,
    assert_sorted_apart,
    mp_leave_side,
    span_of_convex,
    total_length,
)
from tests.helpers.stability.sides import leave_sides
from tests.helpers.stability.surfaces import ball, rays_at, unit


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_ball_far_from_the_origin(offset: float):
    mesh = ball(2, 8.0, tuple(offset * TOWARD))
    shell = extrude(mesh, 2.0, 8.0)
    rng = np.random.default_rng(6)
    inside = shell.base[rng.integers(0, len(shell.base), 2000)] + 4 * rng.normal(size=(2000, 3))
    o, d = rays_at(inside, 20.0, rng)
    trace = Boundary(shell, mesh.faces).trace(o, d)
    assert_sorted_apart(trace)
    assert_ends_on_ray(trace, shell, o, d, 2e-4)
    enters, leaves = span_of_convex((shell.base.astype(np.float64) + shell.offset)[shell.faces], o, d)
    base = span_of_convex(shell.base[shell.faces].astype(np.float64), o, d)
    blocked = base[0] < base[1]
    clear = (np.abs(base[1] - base[0]) > 1e-2) & (base[0] > 0) & (enters > 0)
    length = np.maximum(np.where(blocked, base[0], leaves) - enters, 0)
    assert clear.sum() > 500
    np.testing.assert_array_equal(np.isfinite(trace.end)[clear], blocked[clear])
    np.testing.assert_allclose(total_length(trace, 2000)[clear], length[clear], atol=2e-4)
    np.testing.assert_allclose(trace.end[clear & blocked], base[0][clear & blocked], atol=2e-4)


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_side_relative_to_the_origin_of_the_ray(offset: float):
    rng = np.random.default_rng(7)
    foot = (offset * TOWARD + rng.uniform(-1, 1, (300, 2, 3))).astype(np.float32)
    post = (0.3 * unit(rng.normal(size=(300, 2, 3)))).astype(np.float32)
    u, h = rng.uniform(0.05, 0.95, (2, 300, 1))
    at = (1 - u) * (foot[:, 0] + h * post[:, 0]) + u * (foot[:, 1] + h * post[:, 1])
    d = unit(np.cross(foot[:, 1] - foot[:, 0].astype(np.float64), post[:, 0])).astype(np.float32)
    o = (at - 2 * d).astype(np.float32)  # the ray's origin is on the same grid: differences are exact
    p = foot - o[:, None]
    found = leave_sides(d, p, post)
    hit, t, u, h = (np.array(x) for x in zip(*map(mp_leave_side, d, p, post), strict=True))
    sure = ~found.doubt
    assert sure.mean() > 0.8 and hit.sum() > 100
    np.testing.assert_array_equal((found.inside >= 0)[sure], hit[sure])
    both = sure & hit
    np.testing.assert_allclose(found.t[both], t[both], atol=1e-3)
    np.testing.assert_allclose(found.u[both], u[both], atol=1e-3)
    np.testing.assert_allclose(found.h[both], h[both], atol=1e-3)
