"""The projected discriminator: small heads judge what a network that was trained on photographs sees (Sauer et al., "Projected
GANs converge faster", 2021).

Notation
y, c     as in discriminator.py                                                   (B, S, S, 3 or 4), (B, L)
f        outputs of EfficientNet-Lite0's blocks at ENDS, of the picture at twice its side, in units of SPREAD; with `opacity`
         y's fourth channel joins the map of side S/4                             (B, S, S, 16) … (B, S/8, S/8, 112)
D        a logit for each of f                                                    (B, 4)

The network stays as it is, a constant of the program, in float32; only the heads learn. It knows edges from the first step on:
where the residual discriminator takes thousands of images to tell renders from pictures, heads took hundreds
(docs/results/generator.md). A head halves its map down to 4 × 4, and takes the label by projection as the residual
discriminator does. Losses are as there, and R1 is taken at f: no second derivative goes through the network. The paper's heads
know no label, and have spectral norms and a hinge loss in place of R1; maps are mixed at random before them.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from mesoshell.io.weights import read_lite0
from mesoshell.nets.efficientnet import EfficientNet, activations, efficientnet
from mesoshell.nets.mlp import Dense
from mesoshell.render.composite import encoded
from mesoshell.shell.generator.discriminator import DiscriminatorConfig, check_size
from mesoshell.shell.generator.equalised import Conv, by_label, connected, convolved, halved, lrelu, makers
from mesoshell.typing import Array, Float, Key

#: The last blocks of four stages, their channels, and the root mean squares of their outputs for 16 renders of grass at 64².
ENDS, CHANNELS, SPREAD = (0, 2, 4, 10), (16, 24, 40, 112), (7.0, 8.0, 8.0, 6.0)
#: The map that opacity joins, and what it is multiplied with, so that one channel of 41 is heard.
WITH_OPACITY, LOUDER = 2, 4.0


class Head(NamedTuple):
    """A 1 × 1 convolution, one after each halving, and one more with what its pixels become."""

    first: Conv
    halvings: list[Conv]
    last: Conv
    out: Dense


class Projected(NamedTuple):
    """Learned parameters. embed: of the label, for each head."""

    heads: list[Head]
    embed: list[list[Dense]]


def init_projected(config: DiscriminatorConfig, key: Key[Array, ""]) -> Projected:
    """Unit normal weights, zero biases. Raises ValueError if the size is no power of two ≥ 8."""
    check_size(config)
    conv, dense = makers(iter(jax.random.split(key, 64)))
    width = config.width
    heads = []
    for k, channels in enumerate(CHANNELS):
        sides = [config.size >> k]  # …, 8, 4; or 2 or 1 alone
        while sides[-1] > 4:
            sides.append(sides[-1] // 2)
        first = conv(1, channels + (config.opacity and k == WITH_OPACITY), width(sides[0]))
        halvings = [conv(3, width(2 * s), width(s)) for s in sides[1:]]
        last = conv(3, width(sides[-1]), width(sides[-1]))
        heads.append(Head(first, halvings, last, dense(sides[-1] ** 2 * width(sides[-1]), config.embedding)))
    embed = [[dense(config.labels, config.embedding), dense(config.embedding, config.embedding)] for _ in heads]
    return Projected(heads, embed)


def project(y: Float[Array, "B S S I"]) -> list[Float[Array, "B _h _w _C"]]:
    """f, in float32."""
    y = y.astype(jnp.float32)
    maps = activations(_network(), encoded((y[..., :3] + 1) / 2), ENDS, 2 * y.shape[1])
    f = [x / spread for x, spread in zip(maps, SPREAD, strict=True)]
    if y.shape[-1] == 4:
        batch, side = f[WITH_OPACITY].shape[:2]
        a = y[..., 3:].reshape(batch, side, -1, side, y.shape[1] // side).mean(axis=(2, 4))
        f[WITH_OPACITY] = jnp.concatenate([f[WITH_OPACITY], LOUDER * a[..., None]], axis=-1)
    return f


def judge(
    projected: Projected,
    f: list[Float[Array, "B _h _w _C"]],
    c: Float[Array, "B L"],
    everyone: Callable | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Float[Array, "B 4"]:
    """D. everyone: unused, as a row's logits do not depend on other rows. dtype: of the convolutions but a head's last."""
    logits = []
    for head, embed, x in zip(projected.heads, projected.embed, f, strict=True):
        x = lrelu(convolved(head.first, x.astype(dtype)))
        for layer in head.halvings:
            x = lrelu(convolved(layer, halved(x)))
        x = lrelu(convolved(head.last, x.astype(head.last.weight.dtype))).reshape(x.shape[0], -1)
        logits.append(by_label(embed, connected(head.out, x), c))
    return jnp.stack(logits, axis=1)


@lru_cache
def _network() -> EfficientNet:
    with jax.ensure_compile_time_eval():
        return efficientnet(read_lite0())
