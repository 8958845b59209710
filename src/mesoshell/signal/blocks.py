"""A filtered leaky ReLU by blocks of rows and channels: the fast way on a CPU.

Notation
x, t, y      samples before, at the temporary rate, and after                  (B, H, W, C)
u, d         factors up and down; q = u/d is whole
g            filter of n taps
k, i, j      along one axis: the tap, the result and the term of a sum
phase p      of a row of samples: p, p + P, p + 2P, …; its samples use the same taps

Both filters are sums of one form: result i is Σ_j g[at + o i + s j] of term j, over the j for which g has that tap; up (o, s) =
(1, −u), down (d, −1). Along y, where a block has few rows, the sum is one product with a banded matrix; along x, sums of
shifted phases, which are never interleaved at the temporary rate. The order y, x, bend, y, x keeps sums of shifts apart: XLA
would fuse two of them into one slow pass, and one with the cut of a block from x took four times as long. t stays in the cache;
rows where blocks overlap are computed twice.
`docs/results/performance.md` compares.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.typing import Array

#: Rows of y, and channels, of a block, at most.
ROWS, CHANNELS = 16, 64


class Filters(NamedTuple):
    """Factors and filters; down: pairs (along x, along y), whose products are summed."""

    up: int
    down: int
    up_taps: Float[np.ndarray, "n"]
    down_taps: list[tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]]


class _Sum(NamedTuple):
    """Result i is Σ_j taps[at + o i + s j] of term j."""

    taps: Float[np.ndarray, "n"]
    at: int
    o: int
    s: int


class _Axis(NamedTuple):
    """`count` samples of y are made of `middle` of t by `down`, and those of x[first:first + size] by `up`."""

    up: _Sum
    down: list[_Sum]
    first: int
    size: int
    middle: int
    count: int


def up_bend_down(
    x: Float[Array, "B H W C"], how: Filters, pad: tuple[int, int, int, int], bend: Callable[[Array], Array]
) -> Array:
    """y. pad: samples added or taken away (x before, x after, y before, y after) at the temporary rate."""
    q = how.up // how.down
    size = _outputs(how, pad[2:], x.shape[1]), _outputs(how, pad[:2], x.shape[2])
    blocks = -(-size[0] // ROWS)
    rows, columns = _whole(-(-size[0] // blocks), q), _whole(size[1], q)
    along_y = _axis(how, [g for _, g in how.down_taps], pad[2], rows)
    along_x = _axis(how, [g for g, _ in how.down_taps], pad[0], columns)
    bands = np.concatenate([_band(s, rows, along_y.middle) for s in along_y.down])

    def block(part: Float[Array, "r w c"]) -> Array:
        t = _product(_band(along_y.up, along_y.middle, along_y.size), part)
        t = bend(jnp.stack(_by_phases(along_x.up, how.up, along_x.middle, [t]), axis=1))
        z = _product(bands, t).reshape(len(how.down_taps), rows, *t.shape[1:])
        summands = [
            _by_phases(s, q, columns, [y[:, p] for p in range(how.up)]) for s, y in zip(along_x.down, z, strict=True)
        ]
        y = jnp.stack([functools.reduce(jnp.add, parts) for parts in zip(*summands, strict=True)], axis=2)
        return y.reshape(rows, columns, -1)

    step = rows * how.down // how.up
    padded = _padded(x, (along_y.first, along_x.first), ((blocks - 1) * step + along_y.size, along_x.size))
    y = _each(block, padded, (along_y.size, step), (blocks, rows, columns))
    return y[:, : size[0], : size[1], : x.shape[3]]


def _each(
    block: Callable[[Array], Array],
    x: Float[Array, "B H W C"],
    window: tuple[int, int],
    shape: tuple[int, int, int],
) -> Array:
    """y of all blocks. window: rows of x that a block reads, the step to the next; shape: blocks, their rows and columns."""
    blocks, rows, columns = shape
    batch, _, width, channels = x.shape
    wide = _block_channels(channels)
    groups = channels // wide

    def one(k: Array, y: Array) -> Array:
        image, group, i = k // (groups * blocks), k // blocks % groups, k % blocks
        part = jax.lax.dynamic_slice(x, (image, i * window[1], 0, group * wide), (1, window[0], width, wide))
        return jax.lax.dynamic_update_slice(y, block(part[0])[None], (image, i * rows, 0, group * wide))

    like = jnp.zeros((batch, blocks * rows, columns, channels), x.dtype)
    return jax.lax.fori_loop(0, batch * groups * blocks, one, like)


def _axis(how: Filters, down_taps: list[np.ndarray], before: int, count: int) -> _Axis:
    """The first block of an axis; before: its padding."""
    u, d, n, m = how.up, how.down, len(how.up_taps), len(down_taps[0])
    first, place, middle = -(before // u), before % u, _whole(d * (count - 1) + m, u)
    size = (middle + n - 2 - place) // u + 1
    down = [_Sum(g, m - 1, d, -1) for g in down_taps]
    return _Axis(_Sum(how.up_taps, n - 1 - place, 1, -u), down, first, size, middle, count)


def _outputs(how: Filters, pad: tuple[int, int], inputs: int) -> int:
    return (inputs * how.up + sum(pad) - len(how.up_taps) + 1 - len(how.down_taps[0][0])) // how.down + 1


def _whole(n: int, unit: int) -> int:
    """The least multiple of unit that is not less than n."""
    return -(-n // unit) * unit


def _block_channels(channels: int) -> int:
    """Channels of a block: equal shares, multiples of eight if there are several."""
    groups = -(-channels // CHANNELS)
    return channels if groups == 1 else _whole(-(-channels // groups), 8)


def _padded(x: Float[Array, "B H W C"], first: tuple[int, int], size: tuple[int, int]) -> Array:
    """x[first:first + size] along both axes, 0 where there is no x, and channels for whole blocks."""
    around = [(-f, f + n - have, 0) for f, n, have in zip(first, size, x.shape[1:3], strict=True)]
    channels = _whole(x.shape[3], _block_channels(x.shape[3])) - x.shape[3]
    return jax.lax.pad(x, jnp.zeros((), x.dtype), [(0, 0, 0), *around, (0, channels, 0)])


def _band(s: _Sum, results: int, terms: int) -> Float[np.ndarray, "i j"]:
    k = s.at + s.o * np.arange(results)[:, None] + s.s * np.arange(terms)[None]
    return np.where((k >= 0) & (k < len(s.taps)), s.taps[np.clip(k, 0, len(s.taps) - 1)], 0.0)


def _product(band: Float[np.ndarray, "i j"], x: Float[Array, "j ..."]) -> Float[Array, "i ..."]:
    rows = jnp.matmul(jnp.asarray(band, x.dtype), x.reshape(len(x), -1), precision=jax.lax.Precision.HIGHEST)
    return rows.reshape(len(band), *x.shape[1:])


def _by_phases(s: _Sum, phases: int, results: int, terms: list[Float[Array, "r w c"]]) -> list[Float[Array, "r _v c"]]:
    """Phases of the results from phases of the terms: each next result of a phase reads the next term of each phase."""

    def shifted(j: int) -> Array:
        first = j // len(terms)
        return terms[j % len(terms)][:, first : first + results // phases]

    def phase(p: int) -> Array:
        k = s.at + s.o * p
        parts = [shifted((n - k) // s.s) * g for n, g in enumerate(s.taps.tolist()) if (n - k) % s.s == 0]
        return functools.reduce(jnp.add, parts)

    return [phase(p) for p in range(phases)]
