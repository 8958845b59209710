"""A texture seen from above, without tracing a ray: opacity of its layers, and height of the first thing met.

Notation
n, h        layers, and their heights: the middles of equal parts of [0, TOP]
o           opacity of a layer, 1 − exp(−σ Δh)                                    (S, S, n)
depth       mean height of what is met first from above                           (S, S)
cover       share of the light from above that meets something                    (S, S)

The decoder's trunk is evaluated at every texel and height. `depth` shows the lean of a lawn directly; single layers show it
only by how blobs move from layer to layer (docs/results/generator.md).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.decoder import Decoder
from mesoshell.typing import Array, Float

#: Height that nothing exceeds: recipes leave room under the box's top.
TOP = 0.96


class Above(NamedTuple):
    """Layers from the lowest up. features: the trunk's of each layer; depth, cover: seen from above."""

    opacity: Float[Array, "n S S"]
    features: Float[Array, "n S S W"]
    depth: Float[Array, "S S"]
    cover: Float[Array, "S S"]


def from_above(
    decoder: Decoder,
    octaves: int,
    feature: Float[Array, "S S C"],
    height: Float[Array, "R C"],
    alpha: Float[Array, "A"],
    layers: int = 24,
) -> Above:
    """One texture's layers. height: F(h) at the middles of R equal parts of [0, 1]."""
    h = (jnp.arange(layers, dtype=feature.dtype) + 0.5) / layers * TOP
    side, about = feature.shape[:2], jnp.arange(len(height), dtype=feature.dtype)
    profile = jax.vmap(lambda f: jnp.interp(h * len(height) - 0.5, about, f), in_axes=1, out_axes=1)(height)
    encoded = jax.vmap(lambda x: net.encode_height(x, octaves))(h)

    @jax.checkpoint
    def layer(at: tuple[Array, Array]) -> tuple[Array, Array]:
        inputs = jnp.broadcast_to(jnp.concatenate([at[1], alpha]), (*side, len(at[1]) + len(alpha)))
        return net.trunk(decoder, jnp.concatenate([feature + at[0][None, None], inputs], axis=-1))

    sigma, features = jax.lax.map(layer, (profile, encoded))
    opacity = 1 - jnp.exp(-sigma * (TOP / layers))
    over = jnp.cumprod(1 - opacity[::-1], axis=0)[::-1]
    share = jnp.concatenate([over[1:], jnp.ones_like(over[:1])]) * opacity
    return Above(opacity, features, jnp.einsum("nvu,n->vu", share, h, precision="highest"), jnp.sum(share, axis=0))
