"""Features of EfficientNet-Lite0, which distances between sets of pictures are measured in (Tan and Le 2019; floor 2).

Alphabet
x        pictures, sRGB-encoded values in [0, 1]                                     (B, S, S, 3)
k, s, e  kernel, stride, and how many times wider a block is inside
features mean over the last layer's pixels                                           (B, 1280)

The Lite variant has no squeeze-and-excitation, and ReLU6 throughout. The network saw x·255, less 127, over 128, at 224 pixels:
other sizes are brought there by bilinear interpolation. Normalisation is that of inference, folded into the convolutions.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.typing import Array, Float

SIDE, FEATURES = 224, 1280
_EPSILON = 1e-3
#: Blocks: kernel, stride of the first, widening, channels, repeats.
_STAGES = (
    (3, 1, 1, 16, 1),
    (3, 2, 6, 24, 2),
    (5, 2, 6, 40, 2),
    (3, 2, 6, 80, 3),
    (5, 1, 6, 112, 3),
    (5, 2, 6, 192, 4),
    (3, 1, 6, 320, 1),
)


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
    stem: Conv
    blocks: list[Block]
    head: Conv


def efficientnet(weights: Mapping[str, np.ndarray]) -> EfficientNet:
    """The network from a state dict of the PyTorch port. Raises KeyError if an entry is missing."""

    def conv(weight: str, norm: str) -> Conv:
        gain = weights[f"{norm}.weight"] / np.sqrt(weights[f"{norm}.running_var"] + _EPSILON)
        bias = weights[f"{norm}.bias"] - weights[f"{norm}.running_mean"] * gain
        kernel = weights[f"{weight}.weight"] * gain[:, None, None, None]
        return Conv(jnp.asarray(kernel.transpose(2, 3, 1, 0)), jnp.asarray(bias))

    blocks = []
    for _, _, e, _ in (row[:4] for row in _rows()):
        name = f"_blocks.{len(blocks)}"
        widen = conv(f"{name}._expand_conv", f"{name}._bn0") if e > 1 else None
        depthwise = conv(f"{name}._depthwise_conv", f"{name}._bn1")
        blocks.append(Block(widen, depthwise, conv(f"{name}._project_conv", f"{name}._bn2")))
    return EfficientNet(conv("_conv_stem", "_bn0"), blocks, conv("_conv_head", "_bn1"))


def features(net: EfficientNet, x: Float[Array, "B S S 3"]) -> Float[Array, "B 1280"]:
    x = jax.image.resize(x, (x.shape[0], SIDE, SIDE, 3), "bilinear", antialias=True)
    x = jax.nn.relu6(_convolved(net.stem, (x * 255 - 127) / 128, 2))
    for block, (_, stride, _, channels) in zip(net.blocks, _rows(), strict=True):
        y = x if block.widen is None else jax.nn.relu6(_convolved(block.widen, x))
        y = jax.nn.relu6(_convolved(block.depthwise, y, stride, groups=y.shape[-1]))
        y = _convolved(block.narrow, y)
        x = x + y if stride == 1 and x.shape[-1] == channels else y
    return jnp.mean(jax.nn.relu6(_convolved(net.head, x)), axis=(1, 2))


def _rows() -> list[tuple[int, int, int, int]]:
    """k, s, e and channels of each block."""
    return [(k, s if i == 0 else 1, e, c) for k, s, e, c, repeats in _STAGES for i in range(repeats)]


def _convolved(layer: Conv, x: Float[Array, "B H W I"], stride: int = 1, groups: int = 1) -> Float[Array, "B h w O"]:
    dimensions = ("NHWC", "HWIO", "NHWC")
    y = jax.lax.conv_general_dilated(
        x,
        layer.weight,
        (stride, stride),
        "SAME",
        dimension_numbers=dimensions,
        feature_group_count=groups,
        precision="highest",
    )
    return y + layer.bias[None, None, None]
