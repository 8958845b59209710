"""From a cone's Gaussian in the world to a filter radius on the texture (after MesoGAN, section 5.1).

Notation
d           unit ray direction                                               (3,), world
A           J⁻¹, world to canonical                                          (3, 3)
Σ           σ_t² ddᵀ + σ_r² (1 − ddᵀ), covariance in the world
A Σ Aᵀ      covariance in (u, v, h); its (u, v) block is the ellipse on the tangent plane
a ≥ b       the ellipse's standard deviations; r = min(a, b) = b              patches
σ_h         σ_t |A d|_h, standard deviation along the height                  relative height

The paper takes σ_h from all of Σ. But a cone is a bundle of rays that cross the same heights one after the other: what lies
across a ray at a sample, higher or deeper, its neighbours meet at other samples, which stand for those heights. Blurring
across the ray too mixes tips with roots, and the network is not linear in features: in wide footprints at grazing angles,
grass that was fitted from nearby was four to seven times too bright.
"""

from typing import NamedTuple

import jax.numpy as jnp

from mesoshell.numerics import product, safe_div, safe_sqrt
from mesoshell.typing import Mat3, Scalar, Vec2, Vec3


class Footprint(NamedTuple):
    """minor = r; major and axis (unit, or zero) describe the ellipse's long side; height is σ_h."""

    minor: Scalar
    major: Scalar
    axis: Vec2
    height: Scalar


def footprint(inverse: Mat3, d: Vec3, along: Scalar, across: Scalar) -> Footprint:
    """Project a Gaussian with variances `along` and `across` the ray on the tangent plane, and its part along the ray on the
    height axis."""
    e, spare = product(inverse, d), along - across
    p, q, s = (across * product(inverse[i], inverse[j]) + spare * e[i] * e[j] for i, j in ((0, 0), (1, 1), (0, 1)))
    mean, half = (p + q) / 2, (p - q) / 2
    radius = safe_sqrt(half * half + s * s)
    largest = jnp.maximum(mean + radius, 0)
    smallest = jnp.maximum(safe_div(p * q - s * s, largest), 0)  # det / λ_max: no cancellation for a thin ellipse
    x, y = jnp.where(half >= 0, half + radius, s), jnp.where(half >= 0, s, radius - half)
    axis = jnp.stack([x, y])
    axis = safe_div(axis, jnp.broadcast_to(safe_sqrt(x * x + y * y), (2,)))
    return Footprint(safe_sqrt(smallest), safe_sqrt(largest), axis, jnp.abs(e[2]) * safe_sqrt(along))
