"""Where the samples of a tile's rays lie: in proportion to length, or where light is expected to be lost, by the σ grid.

Notation
R, I, S     rays that meet the shell, intervals, samples of a ray
B, b_k      bins of equal length along a ray, and the largest optical depth that bin k can have, by the σ grid
e_k, T_k    optical depth expected in a bin, EXPECTED · b_k; transmittance before it, exp(−Σ_{j<k} e_j)
p_k         density of samples: LOST_SHARE of them by T_k (1 − e^{−e_k}), the light expected to be lost;
            OCCUPIED_SHARE by 1 − e^{−B b_k}, where there may be anything; the rest everywhere. Σ p_k = 1
x           place on a ray, as a share of its canonical length: sample j lies where the sum of p up to x is (j + shift)/S, and
            stands for the share 1/(S B p_k) of it

Over evenly drawn shifts the estimate of optical depth has no bias, whatever the grid holds: p only says where samples are
dense, and none of them is skipped. (NeRF places its fine samples by the weights of coarse ones, Mildenhall et al. 2020,
section 5.2; the grid stands in for those.)
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mesoshell.nets.batches import batches, capacity, pad
from mesoshell.nets.mlp import in_tiles
from mesoshell.numerics import safe_div
from mesoshell.render.quality import EXPECTED, LOST_SHARE, OCCUPIED_SHARE, WIDEST
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.sampling import Frame, Piece, SampleBudget, place, spread
from mesoshell.shell.material.loader import Grid
from mesoshell.shell.render.kernels import DeviceTables, Samples, StaticConfig, bound, level_of_footprint
from mesoshell.shell.render.media import Media
from mesoshell.typing import Array, Scalar

BINS = 32


class Candidates(NamedTuple):
    """Samples sorted by ray and distance; the ray of each, and the opacity expected of that ray."""

    samples: Samples
    ray: Int[np.ndarray, "N"]
    opacity: Float[np.ndarray, "N"]


class Placed(NamedTuple):
    """Places of a ray's samples as shares of its length, and the shares they stand for."""

    x: Float[np.ndarray, "R S"]
    share: Float[np.ndarray, "R S"]


def even(plan: SampleBudget, length: Float[np.ndarray, "I"]) -> Samples:
    """Samples of a plan, sorted by ray and distance. length: of each interval."""
    row = np.repeat(np.arange(len(length), dtype=np.int32), plan.count)
    within = np.arange(len(row)) - np.repeat(np.cumsum(plan.count) - plan.count, plan.count)
    f = (within + plan.first[row] + plan.shift) * plan.step[row] - plan.begin[row]
    return _samples(row, f, plan.step[row], length)


def by_density(media: Media, i: Intervals, frames: tuple[Piece, Frame], count: int, shift: float) -> Candidates:
    """`count` samples a ray. frames: of the intervals, padded (renderer)."""
    length = np.asarray(frames[1].length)[: len(i.ray)]
    start = np.flatnonzero(np.concatenate([[True], i.ray[1:] != i.ray[:-1]])[: len(i.ray)])
    bins = even(spread(i, length, BINS, "length"), length)
    bounds = np.empty(len(start) * BINS, np.float32)
    for (program, table), own in media.parts(i.prism[bins.row]):
        segments = interval_segments(program, table, *frames, np.int32(len(length)))
        profile = partial(depth_profile, program, table.grid, segments)
        parts = batches(profile, bins.row[own], bins.f[own], bins.step[own])
        bounds[own] = np.concatenate([np.asarray(x) for x in parts])[: len(own)]
    bounds = bounds.reshape(-1, BINS)
    padded = pad(bounds, capacity(len(start)))
    placed = places(count, padded, np.float32(shift), np.int32(len(start)))
    placed = Placed(*(np.asarray(x)[: len(start)] for x in placed))
    opacity = -np.expm1(-EXPECTED * bounds.sum(axis=1, dtype=np.float64))
    samples = on_intervals(placed, length, start)
    return Candidates(samples, i.ray[samples.row], np.repeat(opacity, count))


def on_intervals(placed: Placed, length: Float[np.ndarray, "I"], start: Int[np.ndarray, "R"]) -> Samples:
    """Samples at places on rays. length: of each interval; start: first interval of each ray."""
    count = placed.x.shape[1]
    end = np.cumsum(length, dtype=np.float64)
    begin = end - length
    last = np.append(start[1:], len(length))[: len(start)] - 1
    total = end[last] - begin[start]
    s = (begin[start][:, None] + placed.x * total[:, None]).ravel()
    row = np.clip(np.searchsorted(end, s, side="right"), np.repeat(start, count), np.repeat(last, count))
    step = (placed.share * total[:, None]).ravel()
    return _samples(row.astype(np.int32), s - begin[row], step, length)


def _samples(
    row: Int[np.ndarray, "N"], s: Float[np.ndarray, "N"], step: Float[np.ndarray, "N"], length: Float[np.ndarray, "I"]
) -> Samples:
    """Samples at canonical distance s from the beginning of their intervals."""
    whole = np.maximum(length, np.finfo(np.float32).tiny)[row]
    f, share = np.clip(s / whole, 0, 1), np.minimum(step / whole, 1)
    return Samples(row, f.astype(np.float32), share.astype(np.float32), step.astype(np.float32))


@partial(jax.jit, static_argnums=0)
def interval_segments(
    program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, count: Array
) -> Float[Array, "I 7"]:
    """ξ where an interval begins, the way to its end, and the level of the footprint in its middle."""

    def one(piece: Piece, here: Frame) -> Float[Array, "7"]:
        half = jnp.float32(0.5)
        level = level_of_footprint(program, place(piece, here, half, half, table.cone).footprint)
        return jnp.concatenate([here.xi0, here.xi1 - here.xi0, level[None]])

    return in_tiles(lambda p, a: (jax.vmap(one)(p, a),), count, (pieces, at), ((7, jnp.float32),))[0]


@partial(jax.jit, static_argnums=0)
def depth_profile(
    program: StaticConfig, grid: Grid, segments: Float[Array, "I 7"], row: Array, f: Array, step: Array, count: Array
) -> Float[Array, "N"]:
    """Largest optical depth that pieces of length `step` would have if all of each were as its middle, by the σ grid."""

    def one(row: Array, f: Scalar, step: Scalar) -> Scalar:
        a = segments[row]
        return bound(program, grid, a[:3] + f * a[3:6], a[6]) * step

    return in_tiles(lambda *a: (jax.vmap(one)(*a),), count, (row, f, step), ((0, jnp.float32),))[0]


@partial(jax.jit, static_argnums=0)
def places(samples: int, depth: Float[Array, "R B"], shift: Scalar, count: Array) -> tuple[Array, Array]:
    """`Placed` of rays, given b of each."""
    return in_tiles(
        lambda b: (*jax.vmap(partial(expected_places, samples, shift=shift))(b),),
        count,
        (depth,),
        ((samples, jnp.float32),) * 2,
    )


def expected_places(samples: int, depth: Float[Array, "B"], shift: Scalar) -> tuple[Array, Array]:
    """`Placed` of one ray, given its b."""
    bins = len(depth)
    expected = EXPECTED * depth
    before = jnp.concatenate([jnp.zeros(1, depth.dtype), jnp.cumsum(expected[:-1])])
    lost = jnp.exp(-before) * -jnp.expm1(-expected)
    occupied = -jnp.expm1(-bins * depth)
    p = _shares(LOST_SHARE * _shares(lost) + OCCUPIED_SHARE * _shares(occupied) + 1 / (WIDEST * bins))
    through = jnp.cumsum(p)
    u = (jnp.arange(samples, dtype=depth.dtype) + shift) / samples
    k = jnp.minimum(jnp.sum(through[None] <= u[:, None], axis=1), bins - 1)
    within = jnp.clip((u - through[k]) / p[k] + 1, 0, 1)
    return (k.astype(u.dtype) + within) / bins, 1 / (samples * bins * p[k])


def _shares(x: Float[Array, "B"]) -> Float[Array, "B"]:
    """x over its sum; zero if all are."""
    return safe_div(x, jnp.full_like(x, jnp.sum(x)))
