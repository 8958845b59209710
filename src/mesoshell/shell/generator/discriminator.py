"""The discriminator: whether a picture is a render that fits its label (StyleGAN2's residual network; MesoGAN, 5.1).

Notation
y        picture, 2x/(1 + x) − 1 of linear radiance x over black; with `opacity` also 2a − 1 of the mean opacity a
         of 4 × 4 pixels                                                         (B, S, S, 3 or 4)
c        label: α, β, direction to the camera, log of its distance, direction to the light    (B, L)
S        side of the picture, a power of two; blocks halve it down to 4
D        logit: greater for renders                                               (B,)

The label enters by projection: D = ⟨features(y), embedding(c)⟩/√width. Minibatch deviation is taken over groups of samples that
lie apart in the whole batch, so that it does not depend on how a batch is spread over devices.

Over black, radiance does not tell a gap from a dark blade: a generator that is judged by radiance alone is free to open gaps,
which show what is below where a material lies on a mesh. With `opacity` it is not (the papers' have three channels).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from mesoshell.nets.mlp import Dense
from mesoshell.numerics import safe_sqrt
from mesoshell.shell.generator.equalised import (
    Conv,
    by_label,
    connected,
    convolved,
    halved,
    lrelu,
    makers,
    scaled,
)
from mesoshell.typing import Array, Float, Key

GROUP = 4


@dataclass(frozen=True)
class DiscriminatorConfig:
    """size of the pictures; channels at a side s are min(channel_base / s, channel_max); opacity: whether it sees that too;
    kind: this one, the heads of projected.py, or both (vision_aided.py)."""

    size: int = 64
    channel_base: int = 4096
    channel_max: int = 128
    labels: int = 7
    embedding: int = 64
    opacity: bool = False
    kind: Literal["residual", "projected", "vision-aided"] = "residual"

    def width(self, side: int) -> int:
        """Channels at a side."""
        return min(self.channel_base // side, self.channel_max)


class Block(NamedTuple):
    """From side s to s/2: two convolutions, and a 1 × 1 skip."""

    first: Conv
    second: Conv
    skip: Float[Array, "1 1 I O"]


class Discriminator(NamedTuple):
    """Learned parameters."""

    colour: Conv
    blocks: list[Block]
    last: Conv
    hidden: Dense
    out: Dense
    embed: list[Dense]


@partial(jax.jit, static_argnums=0)
def init_discriminator(config: DiscriminatorConfig, key: Key[Array, ""]) -> Discriminator:
    """Unit normal weights, zero biases. Raises ValueError if the size is no power of two ≥ 8."""
    check_size(config)
    conv, dense = makers(iter(jax.random.split(key, 64)))
    width = config.width
    sides = [config.size >> i for i in range(config.size.bit_length() - 3)]  # … 16, 8
    blocks = [
        Block(conv(3, width(s), width(s)), conv(3, width(s), width(s // 2)), conv(1, width(s), width(s // 2)).weight)
        for s in sides
    ]
    return Discriminator(
        colour=conv(1, 3 + config.opacity, width(config.size)),
        blocks=blocks,
        last=conv(3, width(4) + 1, width(4)),
        hidden=dense(16 * width(4), width(4)),
        out=dense(width(4), config.embedding),
        embed=[dense(config.labels, config.embedding), dense(config.embedding, config.embedding)],
    )


def check_size(config: DiscriminatorConfig) -> None:
    """Raise ValueError if pictures of this size cannot be halved."""
    if config.size < 8 or config.size & (config.size - 1):
        raise ValueError(f"pictures must be a power of two wide and at least 8, not {config.size}")


def discriminate(
    discriminator: Discriminator,
    y: Float[Array, "B S S I"],
    c: Float[Array, "B L"],
    everyone: Callable[[Array], tuple[Array, Array]] | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Float[Array, "B"]:
    """D. everyone: from this device's rows to all devices' and the indices of its own among them, under pmap. dtype: of the
    convolutions of sides above 4; labels, deviation and the layers after it have the weights' precision."""
    d = discriminator
    x = lrelu(convolved(d.colour, y.astype(dtype)))
    for block in d.blocks:
        skip = scaled(block.skip, halved(x))
        inner = lrelu(convolved(block.first, x))
        x = (lrelu(convolved(block.second, halved(inner))) + skip) * jnp.asarray(0.5**0.5, dtype)
    x = x.astype(d.last.weight.dtype)
    x = jnp.concatenate([x, _deviation(x, everyone)], axis=-1)
    x = lrelu(convolved(d.last, x)).reshape(x.shape[0], -1)
    x = connected(d.out, lrelu(connected(d.hidden, x)))
    return by_label(d.embed, x, c)


def _deviation(x: Float[Array, "B H W C"], everyone: Callable | None) -> Float[Array, "B H W 1"]:
    """Mean over channels and pixels of the standard deviation in each sample's group; 0 for a batch of one.

    Groups are of GROUP samples, or of the whole batch if it is not a multiple. Sample i is in group i mod (B / GROUP).
    """
    rows, own = (x, jnp.arange(x.shape[0])) if everyone is None else everyone(x)
    batch = rows.shape[0]
    size = GROUP if batch % GROUP == 0 else batch
    grouped = rows.reshape(size, batch // size, *x.shape[1:])
    variance = jnp.mean(jnp.square(grouped - jnp.mean(grouped, axis=0, keepdims=True)), axis=0)
    deviation = jnp.mean(safe_sqrt(variance + (1e-8 if size > 1 else 0.0)), axis=(1, 2, 3))
    mine = jnp.tile(deviation, size)[own]
    return jnp.broadcast_to(mine[:, None, None, None], (*x.shape[:3], 1))
