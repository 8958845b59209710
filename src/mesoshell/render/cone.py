"""A pixel's cone, and the Gaussian of one piece of it (Barron et al. 2021, equations 7 and 8).

Notation
μ, δ        middle and half length of the piece along the ray, of what lies before its origin      world
ṙ           radius of the cone at distance 1 (a box pixel of width w: w·2/√12)
σ_t², σ_r²  variance along the ray, and across it (each of two axes)           world²
"""

from typing import NamedTuple

import jax.numpy as jnp

from mesoshell.numerics import safe_div
from mesoshell.typing import Scalar


class ConeGaussian(NamedTuple):
    """Mean distance and the two variances of the uniform density in a conical frustum."""

    mean: Scalar
    along: Scalar
    across: Scalar


def cone_gaussian(t: Scalar, half: Scalar, radius: Scalar) -> ConeGaussian:
    """Moments of the frustum from t − half, or the origin, to t + half, in their stable form: exact for a short piece, however
    far, and at the origin; variances are never negative."""
    behind = jnp.maximum(half - t, 0)
    mu, delta = t + behind / 2, half - behind / 2
    squares = 3 * mu * mu + delta * delta
    share = safe_div(delta * delta, squares)  # in [0, 1]: keeps every power below in range
    mean = mu + 2 * mu * share
    along = delta * delta / 3 - 4 / 15 * share * share * (12 * mu * mu - delta * delta)
    across = radius * radius * (mu * mu / 4 + 5 / 12 * delta * delta - 4 / 15 * delta * delta * share)
    return ConeGaussian(mean, jnp.maximum(along, 0), jnp.maximum(across, 0))
