"""Dense networks as plain pytrees, evaluated plainly or in cache-sized tiles.

A layer is a pair (kernel (in, out), bias (out,)); a network is a list of layers. On a CPU, one call on millions of rows
spills every activation to memory; tiles of a few thousand rows keep them in the cache, which is 3.4 times faster. A GPU, which
needs many rows to be busy, was six times slower in such tiles (docs/results/performance.md).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.typing import Array, Float, Key

#: Rows a tile: activations of 4096 × 64 float32 are 1 MiB, inside a core's second-level cache.
TILE = 4096


class Dense(NamedTuple):
    """y = x · kernel + bias."""

    kernel: Float[Array, "I O"]
    bias: Float[Array, "O"]


def init_dense(key: Key[Array, ""], inputs: int, outputs: int, gain: float = 2.0) -> Dense:
    """He initialisation: normal kernel of variance gain / inputs, zero bias."""
    kernel = jax.random.normal(key, (inputs, outputs), jnp.float32) * (gain / inputs) ** 0.5
    return Dense(kernel, jnp.zeros(outputs, jnp.float32))


def init_mlp(key: Key[Array, ""], widths: tuple[int, ...]) -> list[Dense]:
    """One layer for each consecutive pair of widths."""
    keys = jax.random.split(key, max(1, len(widths) - 1))
    return [init_dense(k, i, o) for k, i, o in zip(keys, widths[:-1], widths[1:], strict=False)]


def linear(x: Float[Array, "... I"], kernel: Float[Array, "I O"]) -> Float[Array, "... O"]:
    """x · kernel at the backend's default precision: the only product of this package that a GPU or TPU may round.

    The named scope marks it for benchmarks/products, which looks for others."""
    with jax.named_scope("network"):
        return x @ kernel.astype(x.dtype)


def apply_dense(layer: Dense, x: Float[Array, "... I"]) -> Float[Array, "... O"]:
    """One layer: x W + b."""
    y = linear(x, layer.kernel)
    return y + jnp.broadcast_to(layer.bias.astype(x.dtype), y.shape)


def apply_relu(layers: list[Dense], x: Float[Array, "... I"]) -> Float[Array, "... O"]:
    """Every layer followed by ReLU: the hidden part of a network."""
    for layer in layers:
        x = jax.nn.relu(apply_dense(layer, x))
    return x


def in_tiles(function: Callable, count: Array, rows: tuple, out_like: tuple) -> tuple:
    """`function` on the first `count` rows of each array in `rows`, on a CPU TILE rows at a time, elsewhere all at once.

    count is a traced scalar, so one compiled program serves every number of rows up to the arrays' length (a multiple of
    TILE). out_like: one (width, dtype) for each output array, which has shape (rows, width). Later rows mean nothing.
    """
    length = jax.tree.leaves(rows)[0].shape[0]
    if jax.default_backend() != "cpu":
        return function(*rows)
    outputs = tuple(jnp.zeros((length, *((w,) if w else ())), t) for w, t in out_like)

    def body(i: Array, out: tuple) -> tuple:
        start = i * TILE
        part = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, TILE), rows)
        new = function(*part)
        return tuple(jax.lax.dynamic_update_slice_in_dim(o, n, start, axis=0) for o, n in zip(out, new, strict=True))

    return jax.lax.fori_loop(0, (count + TILE - 1) // TILE, body, outputs)
