"""Hard cases 1, 2, 3 and 7, one side or one cap at a time, through the path tracer's walk; the oracle is mpmath.

It walks in float64 on a mesh's float32 numbers: nothing is redone, so nothing may be wrong by more than its own error bound.
"""

import numpy as np
import pytest

from tests.helpers.stability.dr_march import leave_caps, leave_sides
from tests.helpers.stability.hard_rays import COUNT, KINDS, OFFSETS, TOWARD, grazed_sides, grazing, sides
from tests.helpers.stability.oracles import mp_leave_cap, mp_leave_side
from tests.helpers.stability.surfaces import unit


def exact(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, ...]:
    """Whether rays leave through sides, and t, u, h there."""
    hit, t, u, h = (np.array(x) for x in zip(*map(mp_leave_side, d, p, n), strict=True))
    return hit, t, u, h


@pytest.mark.parametrize("kind", KINDS)
def test_no_planar_or_nearly_planar_side_is_missed(kind: str) -> None:
    d, p, n = sides(kind)
    found = leave_sides(d, p, n)
    hit, t, u, h = exact(d, p, n)
    assert hit.all() and (found.inside >= 0).all()
    np.testing.assert_allclose(found.t, t, atol=1e-12)
    np.testing.assert_allclose(found.u, u, atol=1e-12)
    np.testing.assert_allclose(found.h, h, atol=1e-11)


@pytest.mark.parametrize("twist", [0.0, 1e-4, 0.5])
@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_no_grazed_side_is_wrong_beyond_its_bound(angle: float, twist: float) -> None:
    d, p, n = grazed_sides(angle, twist, np.random.default_rng(2))
    found = leave_sides(d, p, n)
    hit, _, u, h = exact(d, p, n)
    seen = found.inside >= 0
    assert hit.sum() > COUNT / 4 and found.margin[hit].max() < 1e-4
    assert not ((seen != hit) & (np.abs(found.inside) > found.margin)).any()
    both = seen & hit
    assert (np.maximum(np.abs(found.u - u), np.abs(found.h - h)) <= found.margin)[both].all()
    assert both[hit].mean() > 0.99


@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_no_grazed_cap_is_wrong_beyond_its_bound(angle: float) -> None:
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(COUNT, 3, 3))
    weights = rng.dirichlet((1, 1, 1), COUNT) * 1.3 - 0.1
    d = grazing(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), angle, rng)
    at = np.einsum("rk,rki->ri", weights, corners) - rng.uniform(0.1, 4, (COUNT, 1)) * d
    d, corners = d.astype(np.float32), (corners - at[:, None]).astype(np.float32)
    found = leave_caps(d, corners)
    hit, where = (np.array(x) for x in zip(*map(mp_leave_cap, d, corners), strict=True))
    seen = found.inside >= 0
    assert hit.sum() > COUNT / 4 and found.margin[hit].max() < 1e-4
    assert not ((seen != hit) & (np.abs(found.inside) > found.margin)).any()
    both = seen & hit
    assert (np.abs(found.bary - where[:, :2]).max(axis=1) <= found.margin)[both].all()


@pytest.mark.parametrize("offset", OFFSETS)
def test_a_side_relative_to_the_origin_of_the_ray(offset: float) -> None:
    rng = np.random.default_rng(7)
    foot = (offset * TOWARD + rng.uniform(-1, 1, (300, 2, 3))).astype(np.float32).astype(np.float64)
    post = (0.3 * unit(rng.normal(size=(300, 2, 3)))).astype(np.float32)
    u, h = rng.uniform(0.05, 0.95, (2, 300, 1))
    at = (1 - u) * (foot[:, 0] + h * post[:, 0]) + u * (foot[:, 1] + h * post[:, 1])
    d = unit(np.cross(foot[:, 1] - foot[:, 0], post[:, 0])).astype(np.float32)
    o = (at - 2 * d).astype(np.float32).astype(np.float64)
    p = foot - o[:, None]
    found = leave_sides(d, p, post)
    hit, t, u, h = exact(d, p, post)
    sure = np.abs(found.inside) > found.margin
    assert sure.mean() > 0.99 and hit.sum() > 100
    np.testing.assert_array_equal((found.inside >= 0)[sure], hit[sure])
    for a, b in ((found.t, t), (found.u, u), (found.h, h)):
        np.testing.assert_allclose(a[hit & sure], b[hit & sure], atol=1e-9)


def test_both_hits_on_one_side() -> None:
    """A line meets a saddle-shaped side twice: seen from either of its two faces, the ray leaves through it once."""
    rng = np.random.default_rng(10)
    p = np.array([[-1, -0.4, -0.5], [1, 0.4, -0.5]]) + rng.uniform(-0.1, 0.1, (500, 2, 3)) + np.array([0.4, 0.1, 0.3])
    n = np.array([[0, 0.8, 1], [0, -0.8, 1]]) + rng.uniform(-0.1, 0.1, (500, 2, 3))
    d = unit(np.array([0.75, 0, 0.66]) + rng.uniform(-0.1, 0.1, (500, 3)))
    twice = np.ones(500, bool)
    for feet, posts in ((p, n), (p[:, ::-1], n[:, ::-1])):
        found, (hit, t, u, h) = leave_sides(d, feet, posts), exact(d, feet, posts)
        twice &= hit
        np.testing.assert_array_equal(found.inside >= 0, hit)
        for a, b in ((found.t, t), (found.u, u), (found.h, h)):
            np.testing.assert_allclose(a[hit], b[hit], atol=1e-9)
    assert twice.sum() >= 10
