"""The residual discriminator with the projected one's heads beside it (Kumari et al., "Ensembling off-the-shelf models for GAN
training", 2022).

Notation
y, c     as in discriminator.py                                                   (B, S, S, 3 or 4), (B, L)
f        y, and the heads' maps
D        the residual discriminator's logit, once for each head, and the heads'   (B, 8)
γ, γ′    weights of R1: of the heads, and of the residual discriminator over γ

The residual discriminator sees pixels, and so what is finer than a photograph's features, and brightness; heads see features
from the first step on. Losses are means over D, so each side weighs a half. The paper sums losses, and has a network of its own
choice beside the discriminator.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from mesoshell.shell.generator.discriminator import (
    Discriminator,
    DiscriminatorConfig,
    discriminate,
    init_discriminator,
)
from mesoshell.shell.generator.projected import Projected, init_projected, project
from mesoshell.shell.generator.projected import judge as judge_maps
from mesoshell.typing import Array, Float, Key


class VisionAided(NamedTuple):
    """Learned parameters."""

    residual: Discriminator
    projected: Projected


def init_vision_aided(config: DiscriminatorConfig, key: Key[Array, ""]) -> VisionAided:
    """Unit normal weights, zero biases. Raises ValueError if the size is no power of two ≥ 8."""
    k = jax.random.split(key)
    return VisionAided(init_discriminator(config, k[0]), init_projected(config, k[1]))


def perceive(y: Float[Array, "B S S I"]) -> tuple[Array, list[Array]]:
    """f."""
    return y, project(y)


def judge(
    both: VisionAided,
    f: tuple[Array, list[Array]],
    c: Float[Array, "B L"],
    everyone: Callable[[Any], Any] | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Float[Array, "B 8"]:
    """D. everyone, dtype: as in discriminator.py."""
    y, maps = f
    pixels = discriminate(both.residual, y, c, everyone, dtype)
    heads = judge_maps(both.projected, maps, c, everyone, dtype)
    return jnp.concatenate([jnp.repeat(pixels[:, None], heads.shape[1], axis=1), heads], axis=1)


def penalties(pixel_gamma: float) -> tuple[float, ...]:
    """Of R1 at each of f, over γ, so that R1 too is the mean over D: a half of γ′ |∇D|² for y, which 4 equal logits see, and an
    eighth for each head's map."""
    return (pixel_gamma / 2 / 4**2, *(1 / 8,) * 4)
