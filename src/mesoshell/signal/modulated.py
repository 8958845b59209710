"""Convolution whose input channels are scaled a sample, and whose output is scaled back (StyleGAN2, section 2.2; floor 2).

Alphabet
x, y     samples before and after                                              (B, H, W, I), (B, H, W, O)
w        weights, brought to unit mean square an output channel                (k, k, I, O)
s        styles, brought to unit mean square a sample                          (B, I)
g        gain of the input: 1/√(its mean square)                               scalar
d        demodulation 1/√(Σ_{k,I} (w s)² + 1e-8)                               (B, O)

y = d · ((g s · x) ∗ w): scaling the input and the output leaves one convolution for the batch, in place of one for each sample.
The normalisation of w and s changes nothing but the weight of ε, and keeps half-precision products in range.
"""

import jax
import jax.numpy as jnp

from mesoshell.typing import Array, Float

EPSILON = 1e-8


def modulated_conv_plain(
    x: Float[Array, "B H W I"],
    w: Float[Array, "k k I O"],
    s: Float[Array, "B I"],
    g: Float[Array, ""],
    demodulate: bool,
    pad: int,
) -> Array:
    """The definition: the weights of each sample, one convolution a sample."""
    if demodulate:
        w = w * jax.lax.rsqrt(jnp.mean(w**2, axis=(0, 1, 2), keepdims=True))
        s = s * jax.lax.rsqrt(jnp.mean(s**2, axis=1, keepdims=True))

    def one(x: Array, s: Array) -> Array:
        ws = w * s[None, None, :, None]
        if demodulate:
            ws = ws * jax.lax.rsqrt(jnp.sum(ws**2, axis=(0, 1, 2), keepdims=True) + EPSILON)
        return convolve(x[None], g * ws, pad)[0]

    return jax.vmap(one)(x, s)


def modulated_conv(
    x: Float[Array, "B H W I"],
    w: Float[Array, "k k I O"],
    s: Float[Array, "B I"],
    g: Float[Array, ""],
    demodulate: bool,
    pad: int,
) -> Array:
    """The same, as one convolution. pad: zeros around, k − 1 or 0 (valid)."""
    if not demodulate:
        return convolve(x * (g * s)[:, None, None], w, pad)
    w = w * jax.lax.rsqrt(jnp.mean(w**2, axis=(0, 1, 2), keepdims=True))
    s = s * jax.lax.rsqrt(jnp.mean(s**2, axis=1, keepdims=True))
    d = jax.lax.rsqrt(s**2 @ jnp.sum(w**2, axis=(0, 1)) + EPSILON)
    return d[:, None, None] * convolve(x * (g * s)[:, None, None], w, pad)


def convolve(x: Float[Array, "B H W I"], w: Float[Array, "k k I O"], pad: int) -> Array:
    """Correlation, as networks have it: y[p] = Σ_q w[q] x[p + q]."""
    return jax.lax.conv_general_dilated(
        x,
        w.astype(x.dtype),
        (1, 1),
        [(pad, pad)] * 2,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
        precision=jax.lax.Precision.HIGHEST,
    )
