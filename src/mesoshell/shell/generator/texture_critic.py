"""Whether neighbourhoods of a texture look fitted: a discriminator of train/textures/critic_view's maps, a logit per place.

Notation
y        maps of a texture, channels of unit variance                             (B, S, S, I)
β        geometry parameters                                                      (B, G)
D        logits, greater for exemplars: one for each place of a grid              (B, s, s)

Seven convolutions without padding, so that a logit depends on what lies in its window of WINDOW² texels alone. β enters by
projection, as a discriminator's label does (equalised.py). Products are in TF32 where a device has it, and not less (`high`),
with which the penalty's second derivatives stay finite (docs/results/generator.md).
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.nets.mlp import Dense
from mesoshell.shell.generator.equalised import Conv, makers
from mesoshell.shell.generator.generator import in_turns
from mesoshell.typing import Array, Float, Key

#: (side of the kernel, stride, width over the first's) of each convolution.
_LAYERS = ((3, 1, 1), (4, 2, 2), (4, 2, 4), (3, 1, 4), (4, 2, 4), (3, 1, 4), (3, 1, 4))
WINDOW = 64


@dataclass(frozen=True)
class CriticConfig:
    """inputs: I; width: channels of the first convolution; betas: G."""

    inputs: int
    width: int = 96
    betas: int = 0


def grid_side(side: int) -> int:
    """Number of logits along a side of S texels; 0 if S is less than a window."""
    for k, stride, _ in _LAYERS:
        side = max(0, side - k + stride) // stride
    return side


class Critic(NamedTuple):
    """Learned parameters. embed: of β, if there is one."""

    convs: list[Conv]
    out: Dense
    embed: list[Dense]


def init_critic(config: CriticConfig, key: Key[Array, ""]) -> Critic:
    """Unit normal weights, zero biases."""
    conv, dense = makers(iter(jax.random.split(key, 16)))
    convs, inputs = [], config.inputs
    for k, _, wide in _LAYERS:
        convs.append(conv(k, inputs, config.width * wide))
        inputs = config.width * wide
    embed = [dense(3 * config.betas, config.width), dense(config.width, inputs)] if config.betas else []
    return Critic(convs, dense(inputs, 1), embed)


@jax.named_scope("network")
def criticise(critic: Critic, y: Float[Array, "B S S I"], beta: Float[Array, "B G"]) -> Float[Array, "B s s"]:
    """D."""
    x = y
    for layer, (k, stride, _) in zip(critic.convs, _LAYERS, strict=True):
        weight = layer.weight / (k * k * x.shape[-1]) ** 0.5
        where = ("NHWC", "HWIO", "NHWC")
        x = jax.lax.conv_general_dilated(
            x, weight, (stride, stride), "VALID", dimension_numbers=where, precision="high"
        )
        x = jax.nn.leaky_relu(x + layer.bias[None, None, None], 0.2) * 2**0.5
    if not critic.embed:
        return _dense(critic.out, x)[..., 0]
    about = jax.nn.leaky_relu(_dense(critic.embed[0], in_turns(beta)), 0.2) * 2**0.5
    about = _dense(critic.embed[1], about)
    about = about * jax.lax.rsqrt(jnp.mean(about**2, axis=1, keepdims=True) + 1e-8)
    return _dense(critic.out, x)[..., 0] + jnp.mean(x * about[:, None, None], axis=-1) * x.shape[-1] ** 0.5


def _dense(layer: Dense, x: Float[Array, "*B I"]) -> Float[Array, "*B O"]:
    kernel = layer.kernel / layer.kernel.shape[0] ** 0.5
    return jnp.matmul(x, kernel, precision="high") + layer.bias[(None,) * (x.ndim - 1)]
