"""From optical depths to a pixel: transmittance and weights (MesoGAN, equations 1 and 2).

Notation
τ_k         optical depth of sample k along the ray, ≥ 0
T_k         transmittance before sample k, exp(−Σ_{i<k} τ_i): depths are summed, never transmittances multiplied
w_k         T_k · (1 − e^{−τ_k}), the probability that the ray's collision lies in sample k
"""

import jax.numpy as jnp

from mesoshell.numerics import opacity
from mesoshell.typing import Array, Float, Scalar


def weights(tau: Float[Array, "N"]) -> tuple[Float[Array, "N"], Scalar]:
    """w of each sample, and the transmittance of the whole ray. Σw + T = 1."""
    through = jnp.cumsum(tau)
    before = jnp.concatenate([jnp.zeros_like(tau[:1]), through[:-1]])
    return jnp.exp(-before) * opacity(tau), jnp.exp(-through[-1])


def tonemap(radiance: Float[Array, "..."]) -> Float[Array, "..."]:
    """x / (1 + x): what losses and networks see of a radiance x ≥ 0."""
    return radiance / (1 + radiance)


def encoded(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """sRGB of linear x; linear below the knee, also for negative x."""
    knee = 0.0031308
    return jnp.where(x <= knee, 12.92 * x, 1.055 * jnp.maximum(x, knee) ** (1 / 2.4) - 0.055)
