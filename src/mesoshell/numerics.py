"""Divisions, norms and exponentials whose values and gradients are finite for every float, and small products that no
backend rounds.

Each function works on arrays of any shape and of either precision. The rule is the same everywhere: a `where` whose
unused branch could produce an infinity first replaces that branch's *input*, so that neither the value nor the
derivative of the branch not taken can reach the result.

symbol  meaning
σ       extinction, ≥ 0, possibly infinite
τ       optical depth σ·length, ≥ 0
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

#: Largest extinction that enters a product; e^{-1e20·length} is 0 for every length a float32 scene can hold.
SIGMA_MAX = 1e20


def safe_div(a: Float[Array, "..."], b: Float[Array, "..."], fallback: float = 0.0) -> Float[Array, "..."]:
    """a / b, and `fallback` where b is 0 or denormal; the gradient there is 0."""
    zero = jnp.abs(b) < jnp.finfo(b.dtype).tiny
    return jnp.where(zero, jnp.asarray(fallback, b.dtype), _divide(a, jnp.where(zero, jnp.ones_like(b), b)))


@jax.custom_jvp
def _divide(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """a / b, whose derivative divides by b twice: b² would already be 0 for b below 1e-19."""
    return a / b


@_divide.defjvp
def _divide_jvp(primals: tuple, tangents: tuple) -> tuple:
    (a, b), (da, db) = primals, tangents
    q = a / b
    return q, (da - q * db) / b


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """√max(x, 0) with gradient 0, not infinity, at and below 0."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, jnp.ones_like(x))), jnp.zeros_like(x))


def norm(x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean length over the last axis; gradient 0 at the zero vector. Scaled, so 1e±30 neither over- nor underflows."""
    largest = jnp.max(jnp.abs(x), axis=-1)
    usable = (largest >= jnp.finfo(x.dtype).tiny) & jnp.isfinite(largest)
    scale = jax.lax.stop_gradient(
        jnp.where(usable, largest, jnp.ones_like(largest))
    )  # the length does not depend on it
    return scale * safe_sqrt(jnp.sum(jnp.square(x / scale[..., None]), axis=-1))


def product(a: Float[Array, "... K"], b: Float[Array, "K ..."]) -> Float[Array, "..."]:
    """a · b of a few numbers, vectors or matrices, in their own precision: `@` may round them to TF32 on a GPU and to bfloat16
    on a TPU, and sums of products are not rounded anywhere."""
    last = a.ndim - 1
    return jnp.sum(a.reshape(*a.shape, *(1,) * (b.ndim - 1)) * b.reshape(*(1,) * last, *b.shape), axis=last)


def normalise(x: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """x / |x|, and the zero vector for the zero vector."""
    return safe_div(x, jnp.broadcast_to(norm(x)[..., None], x.shape))


def optical_depth(sigma: Float[Array, "..."], length: Float[Array, "..."]) -> Float[Array, "..."]:
    """τ = σ·length with σ held below SIGMA_MAX, so that an infinite σ over no length gives no NaN."""
    return jnp.minimum(sigma, jnp.asarray(SIGMA_MAX, sigma.dtype)) * length


def opacity(tau: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 − e^{−τ} without cancellation for small τ."""
    return -jnp.expm1(-tau)


def softplus(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """log(1 + eˣ): no overflow at ±1e4, gradient in [0, 1], and 1/2 at 0, where max(x, 0) + log1p(e^{−|x|}) has none."""
    return jnp.logaddexp(x, jnp.zeros_like(x))
