"""From optical depths to a pixel: transmittance, weights, and their sampled counterpart (MesoGAN, equations 1 and 2).

Alphabet
τ_k         optical depth of sample k along the ray, ≥ 0
T_k         transmittance before sample k, exp(−Σ_{i<k} τ_i): depths are summed, never transmittances multiplied
w_k         T_k · (1 − e^{−τ_k}), the probability that the ray's collision lies in sample k
"""

import jax.numpy as jnp

from mesoshell.numerics import opacity, safe_div
from mesoshell.typing import Array, Float, Index, Scalar


def weights(tau: Float[Array, "N"]) -> tuple[Float[Array, "N"], Scalar]:
    """w of each sample, and the transmittance of the whole ray. Σw + T = 1."""
    through = jnp.cumsum(tau)
    before = jnp.concatenate([jnp.zeros_like(tau[:1]), through[:-1]])
    return jnp.exp(-before) * opacity(tau), jnp.exp(-through[-1])


def sample_collision(tau: Float[Array, "N"], xi: Scalar) -> tuple[Index, Scalar]:
    """Draw a collision with density T σ: the sample it lies in and where in it, 0 to 1; N where the ray is uncollided.

    xi: uniform in [0, 1). The scattered estimator's weight is then Σ ρ L_i / p(ω′), the uncollided one's is 1.
    """
    target = -jnp.log1p(-xi)  # optical depth at which the ray collides
    through = jnp.cumsum(tau)
    k = jnp.sum(through <= target)
    before = jnp.where(k > 0, through[jnp.maximum(k - 1, 0)], 0)
    return k, jnp.clip(safe_div(target - before, tau[jnp.minimum(k, tau.shape[0] - 1)]), 0, 1)


def tonemap(radiance: Float[Array, "..."]) -> Float[Array, "..."]:
    """x / (1 + x): what losses and networks see of a radiance x ≥ 0."""
    return radiance / (1 + radiance)
