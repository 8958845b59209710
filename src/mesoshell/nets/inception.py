"""Features of Inception v3, on which FID is defined, from the user's weights (Szegedy et al. 2016).

Notation
x          pictures, sRGB-encoded values in [0, 1]                              (B, S, S, 3)
features   mean over the last block's pixels                                    (B, 2048)

Weights: a state dict of PyTorch's Inception v3 with the names of torchvision (`Mixed_5b.branch1x1.conv.weight`). The network
of the original FID differs from torchvision's in its pools: averages do not count padding, and the last block takes a maximum.
"""

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.typing import Array, Float

SIDE, FEATURES = 299, 2048
_EPSILON = 1e-3

#: name → weight (k, k, I, O) and bias (O,), normalisation included.
Inception = dict[str, tuple[Array, Array]]


def inception(weights: Mapping[str, np.ndarray]) -> Inception:
    """The network from a state dict. Raises KeyError if an entry is missing, ValueError if tensors do not fit each other."""
    weights = {n: np.asarray(x, np.float32) for n, x in weights.items()}
    names = [n.removesuffix(".conv.weight") for n in weights if n.endswith(".conv.weight")]
    net = {}
    for n in names:
        gain = weights[f"{n}.bn.weight"] / np.sqrt(weights[f"{n}.bn.running_var"] + _EPSILON)
        kernel = (weights[f"{n}.conv.weight"] * gain[:, None, None, None]).transpose(2, 3, 1, 0)
        net[n] = jnp.asarray(kernel), jnp.asarray(weights[f"{n}.bn.bias"] - weights[f"{n}.bn.running_mean"] * gain)
    picture = jax.ShapeDtypeStruct((1, SIDE, SIDE, 3), jnp.float32)
    try:
        pooled = jax.eval_shape(features, net, picture).shape
    except TypeError as error:
        raise ValueError(str(error)) from None
    if pooled != (1, FEATURES):
        raise ValueError(f"it gives {pooled[1]} features")
    return net


def features(net: Inception, x: Float[Array, "B S S 3"]) -> Float[Array, "B 2048"]:
    """Pooled features of pictures in sRGB, 0 to 1, which are resized to 299²."""
    x = 2 * jax.image.resize(x, (x.shape[0], SIDE, SIDE, 3), "bilinear", antialias=False) - 1
    x = _conv(net, "Conv2d_1a_3x3", x, 2, "VALID")
    x = _conv(net, "Conv2d_2b_3x3", _conv(net, "Conv2d_2a_3x3", x, padding="VALID"))
    x = _largest(x, 2)
    x = _conv(net, "Conv2d_4a_3x3", _conv(net, "Conv2d_3b_1x1", x), padding="VALID")
    x = _largest(x, 2)
    for name in ("Mixed_5b", "Mixed_5c", "Mixed_5d"):
        five, three = ("branch5x5_1", "branch5x5_2"), ("branch3x3dbl_1", "branch3x3dbl_2", "branch3x3dbl_3")
        x = _beside(net, name, x, ("branch1x1",), five, three)
    x = _narrowed(net, "Mixed_6a", x, ("branch3x3",), ("branch3x3dbl_1", "branch3x3dbl_2", "branch3x3dbl_3"))
    for name in ("Mixed_6b", "Mixed_6c", "Mixed_6d", "Mixed_6e"):
        seven = tuple(f"branch7x7_{i}" for i in (1, 2, 3))
        x = _beside(net, name, x, ("branch1x1",), seven, tuple(f"branch7x7dbl_{i}" for i in (1, 2, 3, 4, 5)))
    seven = tuple(f"branch7x7x3_{i}" for i in (1, 2, 3, 4))
    x = _narrowed(net, "Mixed_7a", x, ("branch3x3_1", "branch3x3_2"), seven)
    for name, pool in (("Mixed_7b", _mean), ("Mixed_7c", partial(_largest, stride=1))):
        forked = [_conv(net, f"{name}.branch1x1", x)]
        for stem in (("branch3x3_1",), ("branch3x3dbl_1", "branch3x3dbl_2")):
            y = _chain(net, name, stem, x)
            fork = stem[-1][: stem[-1].index("_")] + ("_2" if len(stem) == 1 else "_3")
            forked += [_conv(net, f"{name}.{fork}{side}", y) for side in "ab"]
        x = jnp.concatenate([*forked, _conv(net, f"{name}.branch_pool", pool(x))], axis=-1)
    return jnp.mean(x, axis=(1, 2))


def _beside(net: Inception, name: str, x: Array, *branches: tuple[str, ...]) -> Array:
    """Branches that keep the size, and a convolved average pool."""
    maps = [_chain(net, name, branch, x) for branch in branches]
    return jnp.concatenate([*maps, _conv(net, f"{name}.branch_pool", _mean(x))], axis=-1)


def _narrowed(net: Inception, name: str, x: Array, *branches: tuple[str, ...]) -> Array:
    """Branches whose last convolution halves the size, and a max pool."""
    maps = [_conv(net, f"{name}.{branch[-1]}", _chain(net, name, branch[:-1], x), 2, "VALID") for branch in branches]
    return jnp.concatenate([*maps, _largest(x, 2)], axis=-1)


def _chain(net: Inception, name: str, branch: tuple[str, ...], x: Array) -> Array:
    for part in branch:
        x = _conv(net, f"{name}.{part}", x)
    return x


def _conv(net: Inception, name: str, x: Array, stride: int = 1, padding: str = "SAME") -> Array:
    weight, bias = net[name]
    dimensions = ("NHWC", "HWIO", "NHWC")
    y = jax.lax.conv_general_dilated(
        x, weight, (stride, stride), padding, dimension_numbers=dimensions, precision="highest"
    )
    return jax.nn.relu(y + bias[None, None, None])


def _largest(x: Array, stride: int) -> Array:
    padding = "SAME" if stride == 1 else "VALID"
    return jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (1, 3, 3, 1), (1, stride, stride, 1), padding)


def _mean(x: Array) -> Array:
    def summed(x: Array) -> Array:
        return jax.lax.reduce_window(x, 0.0, jax.lax.add, (1, 3, 3, 1), (1, 1, 1, 1), "SAME")

    return summed(x) / summed(jnp.ones_like(x[:1, ..., :1]))
