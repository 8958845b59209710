"""What the generator and the discriminator minimise (Goodfellow et al. 2014; Mescheder et al. 2018).

Alphabet
D(y)     logit of a picture, greater for renders                                (B,)
γ        weight of R1
All are means over the batch.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from mesoshell.numerics import softplus
from mesoshell.typing import Array, Float, Scalar


def generator_loss(fake: Float[Array, "B"]) -> Scalar:
    """Non-saturating: −log sigmoid(D(fake))."""
    return jnp.mean(softplus(-fake))


def discriminator_loss(real: Float[Array, "B"], fake: Float[Array, "B"]) -> Scalar:
    """−log sigmoid(D(real)) − log(1 − sigmoid(D(fake)))."""
    return jnp.mean(softplus(-real)) + jnp.mean(softplus(fake))


def r1(logits: Callable[[Array], Array], real: Float[Array, "B S S 3"], gamma: float) -> Scalar:
    """γ/2 · mean of |∇D(y)|² over renders."""
    gradient = jax.grad(lambda y: jnp.sum(logits(y)))(real)
    return gamma / 2 * jnp.mean(jnp.sum(gradient**2, axis=(1, 2, 3)))
