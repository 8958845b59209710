"""Losses of the generator and the discriminator (Goodfellow et al. 2014; Mescheder et al. 2018), and of a regression
(NeRF-Tex; MesoGAN, appendix B).

Notation
D(y)     logits of a picture, greater for renders                               (B,) or (B, heads)
γ        weight of R1
a, b     made and true: linear radiance, or alpha
ε        radiance below which an error counts as a difference, not a ratio
All are means over the batch, and over heads, pixels and channels if there are any.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from mesoshell.numerics import softplus
from mesoshell.typing import Array, Float, Scalar

#: In a dataset of grass the median of covered pixels is 0.16, and a tenth of them lie below this. At a black pixel the gradient
#: is at most 1/ε.
EPSILON = 1e-2


def generator_loss(fake: Float[Array, "B ..."]) -> Scalar:
    """Non-saturating: −log sigmoid(D(fake))."""
    return jnp.mean(softplus(-fake))


def discriminator_loss(real: Float[Array, "B ..."], fake: Float[Array, "B ..."]) -> Scalar:
    """−log sigmoid(D(real)) − log(1 − sigmoid(D(fake)))."""
    return jnp.mean(softplus(-real)) + fake_loss(fake)


def fake_loss(fake: Float[Array, "B ..."]) -> Scalar:
    """−log(1 − sigmoid(D(fake)))."""
    return jnp.mean(softplus(fake))


def r1(logits: Callable[[Any], Array], real: Any, gamma: float | tuple[float, ...]) -> Scalar:
    """γ/2 · mean of |∇ΣD(y)|² over renders, ΣD a row's logits. y: (B, S, S, I), or a tree of such with a γ each, in the order
    of its leaves: then the sum over them."""
    gradient = jax.tree.leaves(jax.grad(lambda y: jnp.sum(logits(y)))(real))
    gammas = gamma if isinstance(gamma, tuple) else (gamma,)
    squares = [k / 2 * jnp.mean(jnp.sum(g**2, axis=(1, 2, 3))) for k, g in zip(gammas, gradient, strict=True)]
    return jnp.sum(jnp.stack(squares))


def smape(a: Float[Array, "B S S 3"], b: Float[Array, "B S S 3"]) -> Scalar:
    """|a − b| / (|a| + |b| + ε): symmetric mean absolute percentage error, 0 to 1. Its gradient is 0 where a = b, black pixels
    included: |a − b| is a maximum of two, since JAX gives |x| the slope 1 at 0."""
    return jnp.mean(jnp.maximum(a - b, b - a) / (jnp.abs(a) + jnp.abs(b) + EPSILON))


def transmittance_loss(a: Float[Array, "B S S"], b: Float[Array, "B S S"]) -> Scalar:
    """Mean square error of 1 − a against 1 − b."""
    return jnp.mean((a - b) ** 2)
