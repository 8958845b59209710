"""Convolution with input channels scaled for each sample, and output scaled back (StyleGAN2, section 2.2).

Notation
x, y     samples before and after                                              (B, H, W, I), (B, H, W, O)
w        weights, brought to unit mean square an output channel                (k, k, I, O)
s        styles, brought to unit mean square a sample                          (B, I), or (B, H, W, I): they vary over x
g        gain of the input: 1/√(its mean square)                               scalar
d        demodulation 1/√(Σ_{k,I} (w s)² + 1e-8)                               (B, O)

y = d · ((g s · x) ∗ w): scaling the input and the output leaves one convolution for the batch, in place of one for each sample.
Styles that vary must be nearly constant over a kernel. The normalisation of w and s changes nothing but the weight of ε, and
keeps half-precision products in range.
"""

import jax
import jax.numpy as jnp

from mesoshell.typing import Array, Float

EPSILON = 1e-8
#: Keeps values and gradients of all-zero arrays finite (its power −3/2 is); a mean square of 1e-20 still becomes 1.
_TINY = 1e-24
#: Numbers in a block of by_rows: 2 MiB of float32.
_BLOCK = 2**19


def modulated_conv(
    x: Float[Array, "B H W I"],
    w: Float[Array, "k k I O"],
    s: Float[Array, "B *place I"],
    g: Float[Array, ""],
    demodulate: bool,
    pad: int,
) -> Array:
    """y of x: one convolution for all samples, in w's type; the rest in x's. pad: zeros around, k − 1 or 0 (valid)."""
    short, w = w.dtype, w.astype(x.dtype)

    def convolved(s: Array, w: Array) -> Array:
        return convolve((x * (g * s)).astype(short), w.astype(short), pad).astype(x.dtype)

    s = s if s.ndim == x.ndim else s[:, None, None]
    if not demodulate:
        return convolved(s, w)
    w, s = _unit(w, s)
    edge = w.shape[0] // 2 - pad if s.shape[1] > 1 else 0
    inner = s[:, edge : s.shape[1] - edge, edge : s.shape[2] - edge]
    power = jnp.matmul(inner**2, jnp.sum(w**2, axis=(0, 1)), precision="highest")
    return jax.lax.rsqrt(power + EPSILON) * convolved(s, w)


def _unit(w: Array, s: Array) -> tuple[Array, Array]:
    """Weights of unit mean square an output channel, styles of unit mean square a sample; those that are all 0 stay so."""
    w = w * jax.lax.rsqrt(jnp.mean(w**2, axis=(0, 1, 2), keepdims=True) + _TINY)
    return w, s * jax.lax.rsqrt(jnp.mean(s**2, axis=-1, keepdims=True) + _TINY)


def convolve(x: Float[Array, "B H W I"], w: Float[Array, "k k I O"], pad: int) -> Array:
    """Correlation, as in networks: y[p] = Σ_q w[q] x[p + q], the fastest way on the backend (see by_rows)."""
    x = jnp.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))
    w = w.astype(x.dtype)
    if w.shape[0] == 1:
        return jnp.matmul(x, w[0, 0], precision=jax.lax.Precision.HIGHEST)
    return jax.lax.platform_dependent(x, w, cpu=by_rows, default=by_library)


def by_library(x: Float[Array, "B H W I"], w: Float[Array, "k k I O"]) -> Array:
    """XLA's convolution, without padding."""
    precision = None if x.dtype == jnp.bfloat16 else jax.lax.Precision.HIGHEST
    dimensions = ("NHWC", "HWIO", "NHWC")
    return jax.lax.conv_general_dilated(x, w, (1, 1), "VALID", dimension_numbers=dimensions, precision=precision)


def by_rows(x: Float[Array, "B H W I"], w: Float[Array, "k k I O"]) -> Array:
    """The same as k matrix products per block of rows: neighbours along a row side by side, a block in the cache."""
    k, (batch, height, width, channels) = w.shape[0], x.shape
    h, wide = height - k + 1, width - k + 1
    rows = min(h, max(2, _BLOCK // (wide * k * channels)))
    blocks = -(-h // rows)
    x = jnp.pad(x, ((0, 0), (0, blocks * rows - h), (0, 0), (0, 0)))
    parts = jnp.stack([x[:, i * rows : (i + 1) * rows + k - 1] for i in range(blocks)], axis=1)

    @jax.checkpoint
    def block(part: Array) -> Array:
        beside = jnp.concatenate([part[:, j : j + wide] for j in range(k)], axis=-1)
        kernels = (w[i].reshape(k * channels, -1) for i in range(k))
        products = (jnp.matmul(beside[i : i + rows], v, precision="highest") for i, v in enumerate(kernels))
        return sum(products, jnp.zeros((), x.dtype))

    y = jax.lax.map(block, parts.reshape(-1, *parts.shape[2:]))
    return y.reshape(batch, blocks * rows, wide, -1)[:, :h]
