"""Layers of discriminators, at an equalised learning rate (Karras et al., "Progressive growing of GANs", 2018, section 4.1).

Notation
weight   unit normal at the start; 1/√inputs scales it where it is used
e        embedding of a label: two dense layers, to unit mean square              (B, E)
D        ⟨x, e⟩/√E: the label enters by projection                               (B,)
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.nets.mlp import Dense
from mesoshell.signal.modulated import convolve
from mesoshell.signal.upfirdn import Resampling, resample
from mesoshell.typing import Array, Float, Key

_BLUR = (1 / 8, 3 / 8, 3 / 8, 1 / 8)


class Conv(NamedTuple):
    """weight (k, k, I, O), scaled by 1/√(k²I) where it is used; bias (O,)."""

    weight: Float[Array, "k k I O"]
    bias: Float[Array, "O"]


class Makers(NamedTuple):
    """conv: (k, inputs, outputs) → Conv; dense: (inputs, outputs) → Dense."""

    conv: Callable[[int, int, int], Conv]
    dense: Callable[[int, int], Dense]


def makers(keys: Iterator[Key[Array, ""]]) -> Makers:
    """Layers with unit normal weights and zero biases, each with the next key."""

    def conv(k: int, inputs: int, outputs: int) -> Conv:
        weight = jax.random.normal(next(keys), (k, k, inputs, outputs), jnp.float32)
        return Conv(weight, jnp.zeros(outputs, jnp.float32))

    def dense(inputs: int, outputs: int) -> Dense:
        return Dense(jax.random.normal(next(keys), (inputs, outputs), jnp.float32), jnp.zeros(outputs, jnp.float32))

    return Makers(conv, dense)


def convolved(layer: Conv, x: Float[Array, "B H W I"]) -> Float[Array, "B H W O"]:
    """The layer of x, in x's type."""
    return scaled(layer.weight, x) + layer.bias.astype(x.dtype)[None, None, None]


def scaled(weight: Float[Array, "k k I O"], x: Float[Array, "B H W I"]) -> Float[Array, "B H W O"]:
    """x convolved with a weight, without a bias."""
    k, _, inputs, _ = weight.shape
    return convolve(x, (weight / (k * k * inputs) ** 0.5).astype(x.dtype), k // 2)


def connected(layer: Dense, x: Float[Array, "B I"]) -> Float[Array, "B O"]:
    """The dense layer of x."""
    kernel = layer.kernel / layer.kernel.shape[0] ** 0.5
    return jnp.matmul(x, kernel, precision="highest") + layer.bias[None]


def lrelu(x: Array) -> Array:
    """Slope 0.2 below 0, times √2."""
    return jax.nn.leaky_relu(x, 0.2) * jnp.asarray(2**0.5, x.dtype)


def halved(x: Float[Array, "B H W C"]) -> Float[Array, "B h w C"]:
    """Halve the side: blur with four taps, keep every second sample; the border is black."""
    how = Resampling(_BLUR, 1, 2, (1, 1))
    return resample(resample(x, how, 1), how, 2)


def by_label(embed: list[Dense], x: Float[Array, "B E"], c: Float[Array, "B L"]) -> Float[Array, "B"]:
    """D of features x and labels c."""
    e = connected(embed[1], lrelu(connected(embed[0], c)))
    e = e * jax.lax.rsqrt(jnp.mean(e**2, axis=1, keepdims=True) + 1e-8)
    return jnp.sum(x * e, axis=1) / x.shape[1] ** 0.5
