"""Walks of many rays through the shell: compiled in chunks, doubtful ones repeated in float64.

A *visit* is one stay of a ray in the shell, from the face where it enters to the face where it leaves.

The compiled program takes CAPACITY rays at most (CHUNK in float64) and serves any number below: it works through them in
chunks of CHUNK rays that enter and advance in lock-step, STEPS prisms at most, and stops a chunk when all its rays have left.
Rays that need more go on in the next call, packed together, so a few long grazing rays do not hold the others up. Most calls
are of a few rays: rows for more would only be cleared and copied.

The program runs on the host's CPU, also beside a GPU: its steps are many and small, and a GPU took ten times as long for them
(docs/results/performance.md).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.shell.geometry.march import ENTERING, LOST, WALKING, Prisms, Ray, WalkState, begun, walk
from mesoshell.typing import Array

CAPACITY, CHUNK, STEPS = 1024, 128, 16
#: Prisms after which a walk counts as lost: one that grazes a grid of over 1500 quads a side goes on from there.
LONGEST = 4096


class Intervals(NamedTuple):
    """Intervals of many rays. ray: index of the ray; λ (bary) and h at both ends; t from each ray's origin."""

    ray: Int[np.ndarray, "I"]
    prism: Int[np.ndarray, "I"]
    t0: Float[np.ndarray, "I"]
    t1: Float[np.ndarray, "I"]
    bary0: Float[np.ndarray, "I 2"]
    bary1: Float[np.ndarray, "I 2"]
    h0: Float[np.ndarray, "I"]
    h1: Float[np.ndarray, "I"]


class Visits(NamedTuple):
    """One visit a ray: its intervals, the code of the face it left through (LOST: it met no prism), and where.

    doubt: a decision lay within its rounding error. t, prism, bary: the place of leaving.
    """

    intervals: Intervals
    left: Int[np.ndarray, "R"]
    t: Float[np.ndarray, "R"]
    prism: Int[np.ndarray, "R"]
    bary: Float[np.ndarray, "R 2"]
    doubt: Bool[np.ndarray, "R"]


class Starts(NamedTuple):
    """Rays that are about to enter: a point on each ray near its entry (float64), direction, prism, code of the face."""

    point: Float[np.ndarray, "R 3"]
    direction: Float[np.ndarray, "R 3"]
    prism: Int[np.ndarray, "R"]
    code: Int[np.ndarray, "R"]


def on_host(prisms: Prisms) -> Prisms:
    """Tables on the host's CPU, where the walk follows them; on JAX's default device where JAX has no CPU (JAX_PLATFORMS)."""
    try:
        host = jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        host = None
    return jax.device_put(prisms, host)


def visit(prisms: Prisms, starts: Starts, exact: bool = False) -> tuple[Visits, int]:
    """All visits, and how many of them were repeated in float64. exact: compute every one in float64."""
    if exact:
        with jax.enable_x64(True):
            return _visit(prisms, starts, np.float64), len(starts.code)
    first = _visit(prisms, starts, np.float32)
    again = np.flatnonzero(first.doubt)
    if not len(again):
        return first, 0
    with jax.enable_x64(True):
        second = _visit(prisms, Starts(*(x[again] for x in starts)), np.float64)
    kept = ~first.doubt[first.intervals.ray]
    moved = second.intervals._replace(ray=again[second.intervals.ray])
    intervals = Intervals(
        *(np.concatenate([a[kept], b.astype(a.dtype)]) for a, b in zip(first.intervals, moved, strict=True))
    )
    ends = []
    for a, b in zip(first[1:], second[1:], strict=True):
        a = a.copy()
        a[again] = b
        ends.append(a)
    return Visits(intervals, *ends), len(again)


def compile_walk(prisms: Prisms, exact: bool) -> None:
    """Compile what visits call, in float64 if exact."""
    dtype, rows = (np.float64, CHUNK) if exact else (np.float32, CAPACITY)
    with jax.enable_x64(exact):
        parts: Any = [np.zeros((rows, 3), dtype) for _ in range(3)]
        zeros = np.zeros(rows, np.int32)
        _advance(prisms, Ray(*parts), zeros, _entering(zeros, dtype), np.int32(0))


def _visit(prisms: Prisms, starts: Starts, dtype: type) -> Visits:
    """Visits in one precision, in batches of at most CAPACITY rays that are still walking."""
    near = starts.point.astype(np.float32)
    parts: Any = (near, starts.point - near.astype(np.float64), starts.direction)
    rays = Ray(*(x.astype(dtype) for x in parts))
    capacity = CAPACITY if dtype is np.float32 else CHUNK
    place: Any = _entering(starts.prism, dtype)
    compacted = [no_intervals()]
    walking = np.arange(len(starts.code))
    for _ in range(0, LONGEST, STEPS):
        if not len(walking):
            break
        for part in np.split(walking, range(capacity, len(walking), capacity)):
            n = len(part)
            some = jax.tree.map(lambda x, part=part: _padded(x[part], capacity), (rays, starts.code, place))
            after, rows, used = jax.tree.map(np.asarray, _advance(prisms, *some, np.int32(n)))
            for whole, new in zip(place, after, strict=True):
                whole[part] = new[:n]
            compacted.append(_compact(rows, used[:n], part))
        walking = np.flatnonzero(place.exit == WALKING)
    place.exit[place.exit == WALKING] = LOST
    intervals = Intervals(*(np.concatenate(c) for c in zip(*compacted, strict=True)))
    return Visits(intervals, place.exit, place.t, place.prism, place.bary, place.doubt)


def _entering(prism: Int[np.ndarray, "n"], dtype: type) -> WalkState:
    """Places of rays that are about to enter prisms."""
    n = len(prism)
    t, slack, h = np.zeros((3, n), dtype)
    codes: Any = np.full(n, ENTERING, np.int32)
    parts: Any = (prism.astype(np.int32), t, slack, np.zeros((n, 2), dtype), h, codes, np.zeros(n, bool))
    return WalkState(*parts)


def _compact(rows: tuple, used: Int[np.ndarray, "n"], part: Int[np.ndarray, "n"]) -> Intervals:
    """Rows (STEPS, CAPACITY) of a call to a flat list, ray by ray, each ray's along it."""
    row, step = np.nonzero(np.arange(STEPS) < used[:, None])
    at = step * rows[0].shape[1] + row
    prism, t0, t1, bary0, h0, bary1, h1 = (np.take(x.reshape(-1, *x.shape[2:]), at, axis=0) for x in rows)
    return Intervals(part[row], prism, t0, t1, bary0, bary1, h0, h1)


def _padded(x: np.ndarray, rows: int) -> np.ndarray:
    return np.concatenate([x, np.zeros((rows - len(x), *x.shape[1:]), x.dtype)]) if len(x) < rows else x


def no_intervals() -> Intervals:
    """None at all."""
    none, pair, index = np.zeros(0, np.float32), np.zeros((0, 2), np.float32), np.zeros(0, np.int32)
    return Intervals(index, index, none, none, pair, pair, none, none)


@partial(jax.jit, inline=True)
def _walked(prisms: Prisms, rays: Ray, code: Array, place: WalkState) -> tuple:
    """`begun`, and `walk`, of many rays. What is jitted is traced once, however often it is called."""
    return walk(prisms, rays, jax.vmap(begun, in_axes=(None, 0, 0, 0))(prisms, rays, code, place), STEPS)


@jax.jit
def _advance(prisms: Prisms, rays: Ray, code: Array, place: WalkState, count: Array) -> tuple:
    """`_walked` on the first `count` rays, a chunk at a time."""
    length = place.t.shape[0]
    chunk = min(CHUNK, length)
    part = jax.eval_shape(_walked, prisms, *_slice((rays, code, place), 0, chunk))
    rows = jax.tree.map(lambda s: jnp.zeros((STEPS, length, *s.shape[2:]), s.dtype), part[1])

    def body(i: Array, carry: tuple) -> tuple:
        place, rows, used = carry
        begin = i * chunk
        after, new, steps = _walked(prisms, *_slice((rays, code, place), begin, chunk))
        place = jax.tree.map(lambda a, b: jax.lax.dynamic_update_slice_in_dim(a, b, begin, 0), place, after)
        rows = jax.tree.map(lambda a, b: jax.lax.dynamic_update_slice_in_dim(a, b, begin, 1), rows, new)
        return place, rows, jax.lax.dynamic_update_slice_in_dim(used, steps, begin, 0)

    begin: Any = (place, rows, jnp.zeros(length, jnp.int32))
    return jax.lax.fori_loop(0, (count + chunk - 1) // chunk, body, begin)


def _slice(tree: tuple, begin: Array | int, size: int) -> tuple:
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, begin, size), tree)
