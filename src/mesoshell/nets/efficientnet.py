"""Features of EfficientNet-Lite0 and Lite2, for distances between sets of pictures and for a discriminator (Tan and Le 2019).

Notation
x           pictures, sRGB-encoded values in [0, 1]                                  (B, S, S, 3)
k           side of a kernel
activations outputs of some blocks, not pooled                                       (B, h, h, C) each
features    mean over the last layer's pixels                                        (B, 1280)

The Lite variants have no squeeze-and-excitation, and ReLU6 throughout. The network saw x·255, less 127, over 128, at `side`
pixels: other sizes are resampled bilinearly. Normalisation is that of inference, folded into the convolutions.
Lite2 has `depth` times the blocks of Lite0 in each stage but the first and the last; widths follow from the weights.
"""

import itertools
from collections.abc import Mapping
from math import ceil
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.typing import Array, Float

_EPSILON = 1e-3
#: Stride of a stage's first block, and its number of blocks.
_STAGES = ((1, 1), (2, 2), (2, 2), (2, 3), (1, 3), (2, 4), (1, 1))


class Variant(NamedTuple):
    """side: of the pictures it sees, pixels; depth: see above."""

    side: int
    depth: float


LITE0, LITE2 = Variant(224, 1.0), Variant(260, 1.2)


class Conv(NamedTuple):
    """weight (k, k, I / groups, O) and bias (O,), normalisation included."""

    weight: Float[Array, "k k I O"]
    bias: Float[Array, "O"]


class Block(NamedTuple):
    """Widen (none at e = 1), filter each channel, narrow."""

    widen: Conv | None
    depthwise: Conv
    narrow: Conv


class EfficientNet(NamedTuple):
    """First convolution, blocks, and the last convolution before the pooling."""

    stem: Conv
    blocks: list[Block]
    head: Conv


def efficientnet(weights: Mapping[str, np.ndarray], variant: Variant = LITE0) -> EfficientNet:
    """The network from a state dict of the PyTorch port. Raises KeyError if an entry is missing."""

    def conv(weight: str, norm: str) -> Conv:
        gain = weights[f"{norm}.weight"] / np.sqrt(weights[f"{norm}.running_var"] + _EPSILON)
        bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * gain
        kernel = weights[f"{weight}.weight"] * gain[:, None, None, None]
        return Conv(jnp.asarray(kernel.transpose(2, 3, 1, 0)), jnp.asarray(bias))

    blocks = []
    for i in range(len(_strides(variant))):
        name = f"_blocks.{i}"
        widen = conv(f"{name}._expand_conv", f"{name}._bn0") if i else None
        depthwise = conv(f"{name}._depthwise_conv", f"{name}._bn1")
        blocks.append(Block(widen, depthwise, conv(f"{name}._project_conv", f"{name}._bn2")))
    return EfficientNet(conv("_conv_stem", "_bn0"), blocks, conv("_conv_head", "_bn1"))


def features(net: EfficientNet, x: Float[Array, "B S S 3"], variant: Variant = LITE0) -> Float[Array, "B 1280"]:
    """Pooled features of pictures in sRGB, 0 to 1, which are resized to the network's side."""
    (x,) = activations(net, x, (len(net.blocks) - 1,), variant.side, variant)
    return jnp.mean(jax.nn.relu6(_convolved(net.head, x)), axis=(1, 2))


def activations(
    net: EfficientNet, x: Float[Array, "B S S 3"], ends: tuple[int, ...], side: int, variant: Variant = LITE0
) -> list[Float[Array, "B _h _w _C"]]:
    """Outputs of the blocks `ends` for pictures in sRGB, 0 to 1, resized to `side`. No block after the last is computed."""
    x = jax.image.resize(x, (x.shape[0], side, side, 3), "bilinear", antialias=True)
    x = jax.nn.relu6(_convolved(net.stem, (x * 255 - 127) / 128, 2))
    outputs = {}
    for i, (block, stride) in enumerate(list(zip(net.blocks, _strides(variant), strict=True))[: max(ends) + 1]):
        y = x if block.widen is None else jax.nn.relu6(_convolved(block.widen, x))
        y = jax.nn.relu6(_filtered(block.depthwise, y, stride))
        y = _convolved(block.narrow, y)
        x = x + y if stride == 1 and x.shape[-1] == y.shape[-1] else y
        outputs[i] = x
    return [outputs[i] for i in ends]


def _strides(variant: Variant) -> list[int]:
    """Stride of each block."""
    last = len(_STAGES) - 1
    counts = [n if i in (0, last) else ceil(n * variant.depth) for i, (_, n) in enumerate(_STAGES)]
    return [stride if k == 0 else 1 for (stride, _), n in zip(_STAGES, counts, strict=True) for k in range(n)]


def _convolved(layer: Conv, x: Float[Array, "B H W I"], stride: int = 1) -> Float[Array, "B h w O"]:
    dimensions = ("NHWC", "HWIO", "NHWC")
    y = jax.lax.conv_general_dilated(
        x,
        layer.weight,
        (stride, stride),
        "SAME",
        dimension_numbers=dimensions,
        precision="highest",
    )
    return y + layer.bias[None, None, None]


def _filtered(layer: Conv, x: Float[Array, "B H W C"], stride: int) -> Float[Array, "B h w C"]:
    """Each channel by its own kernel, as a sum of shifted products: XLA's grouped convolution is five times slower on a CPU."""
    k, size = layer.weight.shape[0], -(-x.shape[1] // stride)
    pad = max((size - 1) * stride + k - x.shape[1], 0)
    sides, last = (pad // 2, pad - pad // 2), (size - 1) * stride + 1
    x = jnp.pad(x, ((0, 0), sides, sides, (0, 0)))
    y = layer.bias[None, None, None]
    for i, j in itertools.product(range(k), range(k)):
        y = y + x[:, i : i + last : stride, j : j + last : stride] * layer.weight[i, j][None, None]
    return y
