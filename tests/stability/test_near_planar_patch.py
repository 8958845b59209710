"""Hard case 1: rays through the interior of planar and nearly planar sides; the oracle solves the patch in mpmath.

A third of the sides has twist 0 with equal posts (a = 0), a third is a planar trapezoid, a third is twisted by 1e-6.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.geometry.patch import leave_side, post_function
from tests.helpers.stability.hard_rays import KINDS, sides
from tests.helpers.stability.oracles import mp_leave_side
from tests.helpers.stability.sides import leave_sides


def naive_misses(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Whether (−b + √(b² − 4ac)) / 2a in float32 finds no u in [0, 1], or one that is off by 0.01."""
    a = np.einsum("ri,ri->r", d, np.cross(p[:, 1] - p[:, 0], n[:, 1] - n[:, 0]))
    c, last = (np.einsum("ri,ri->r", d, np.cross(p[:, k], n[:, k])) for k in (0, 1))
    b = last - c - a
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    exact = np.array([mp_leave_side(*row)[2] for row in zip(d, p, n, strict=True)])
    return ~(np.abs(u - exact) < 0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_none_is_missed(kind: str):
    d, p, n = sides(kind)
    found = leave_sides(d, p, n)
    hit, t, u, h = (np.array(x) for x in zip(*map(mp_leave_side, d, p, n), strict=True))
    assert hit.all()
    assert (found.inside >= 0).all()
    np.testing.assert_allclose(found.t, t, atol=2e-5)
    np.testing.assert_allclose(found.u, u, atol=2e-5)
    np.testing.assert_allclose(found.h, h, atol=2e-4)
    assert found.doubt.mean() < 0.05


@pytest.mark.parametrize(("kind", "least"), [("equal", 1.0), ("twisted", 0.05)])
def test_the_naive_quadratic_misses(kind: str, least: float):
    assert naive_misses(*sides(kind)).mean() >= least


def test_gradients_are_finite_at_a_planar_side():
    d, p, n = (jnp.asarray(x[0]) for x in sides("equal"))

    def distance(d: jax.Array) -> jax.Array:
        return leave_side(d, p, n, jnp.stack([post_function(d, p[k], n[k]) for k in (0, 1)])).t

    assert np.isfinite(jax.grad(distance)(d)).all()
