"""The number of devices, and how a step is spread over them. No other file knows them.

Notation
D           devices; each takes an equal share of a step's rows (rays, pictures), and all hold the same parameters
g           gradient; the step's is the mean over devices of each device's own: pmean(grad(loss)), since grad(pmean(loss))
            inside a mapped function counts every device's cotangent again
requests    (2,) whether to stop, and to save, after the step: each host sends its own, and all receive what any of them
            sent. 8 bytes more in the step's sums; with a single host they are not in the program

One CPU is split into as many devices as it has cores: one device runs these loops on one core.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from mesoshell.errors import InputError
from mesoshell.train.update import HERE, Across
from mesoshell.typing import Array

AXIS = "rows"


def split_cpu(rows: int = 0) -> None:
    """One device a core, or fewer, so that they divide the rows of a step; call it before JAX starts. A count that the user has
    set in XLA_FLAGS stays."""
    cores = os.cpu_count() or 1
    devices = max(n for n in range(1, cores + 1) if rows % n == 0)
    flag = "--xla_force_host_platform_device_count"
    flags = os.environ.get("XLA_FLAGS", "")
    if flag not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {flag}={devices}".strip()


def rows_of(rays: int) -> int:
    """Rows of a fit's step that its rays are split into: 8, one for every 512 rays of a multiple of 4096, or 1 if nothing else
    divides them."""
    if rays % 4096 == 0:
        return rays // 512
    return 8 if rays % 8 == 0 else 1


def device_count() -> int:
    """Devices of all hosts together."""
    return len(jax.devices())


def spread(tree):
    """Arrays whose first axis is split over all devices; its length must be a multiple of their number."""
    return jax.device_put(tree, NamedSharding(_mesh(), P(AXIS)))


def replicate(tree):
    """Arrays that every device holds whole."""
    return jax.device_put(tree, NamedSharding(_mesh(), P()))


class ParallelStep(NamedTuple):
    """A step on all devices of all hosts: (state, batch, this host's requests) → (state, report, any host's requests). place: a
    state, the same on every host, to every device; share: this host's rows of a batch, to its devices; whole: a placed state
    as arrays of this host, without a transfer from others."""

    step: Callable[..., tuple[Any, Any, Sequence[Any]]]
    place: Callable[[Any], Any]
    share: Callable[[Any], Any]
    whole: Callable[[Any], Any]


def spread_step(
    step: Callable[[Any, Any, Across], tuple[Any, Any]], batch: int, how: str = "jit", together: int = 1
) -> ParallelStep:
    """`step` under `jit` with a sharded batch, or under `pmap`. batch: rows of all hosts; together: how many consecutive
    rows belong to each other. Raises InputError if devices cannot share the rows evenly, or pmap would separate such rows."""
    if batch % device_count() or batch % together:
        raise InputError("batch", f"{batch} is no multiple of the {device_count()} devices and the {together} views")
    if how == "pmap" and batch // device_count() % together:
        raise InputError(
            "batch", f"{batch} leaves {batch // device_count()} to a device, which separates {together} views"
        )
    return _by_pmap(step) if how == "pmap" else _by_jit(step)


def in_turn(f: Callable) -> Callable:
    """f on each row, one after the other: on one CPU pictures stay in its cache, and rays that miss cost nothing."""
    return lambda *rows: jax.lax.map(lambda row: f(*row), rows)


def _by_jit(step: Callable) -> ParallelStep:
    """Arrays are global: the compiler spreads the work on the batch, and means are over all of it."""
    rows, all_of_it = NamedSharding(_mesh(), P(AXIS)), NamedSharding(_mesh(), P())
    across = HERE._replace(each=in_turn) if jax.default_backend() == "cpu" and device_count() == 1 else HERE

    def share(batch: Any) -> Any:
        return jax.tree.map(lambda x: jax.make_array_from_process_local_data(rows, np.asarray(x)), batch)

    if jax.process_count() == 1:
        alone = jax.jit(lambda state, batch: step(state, batch, across), out_shardings=all_of_it, donate_argnums=0)
        return ParallelStep(
            lambda state, batch, requests=(): (*alone(state, batch), requests), replicate, share, lambda state: state
        )

    def agreed(state: Any, batch: Any, requests: Array) -> tuple[Any, Any, Array]:
        return *step(state, batch, across), jnp.max(requests, axis=0)

    compiled = jax.jit(agreed, out_shardings=all_of_it, donate_argnums=0)

    def run(state: Any, batch: Any, requests: Sequence[bool]) -> tuple[Any, Any, Sequence[Any]]:
        state, report, heard = compiled(state, batch, share(_by_device(requests)))
        return state, report, np.asarray(heard).tolist()

    def place(state: Any) -> Any:
        # device_put of another host's devices would compare the arrays of all hosts, one by one
        return jax.tree.map(
            lambda x: jax.make_array_from_callback(x.shape, all_of_it, np.asarray(x).__getitem__), state
        )

    return ParallelStep(run, place, share, lambda state: jax.tree.map(np.asarray, state))


def _by_pmap(step: Callable) -> ParallelStep:
    """Each device has rows of its own: means and groups over all devices are computed explicitly."""
    devices = jax.local_device_count()

    def everyone(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        rows = jax.lax.all_gather(x, AXIS, tiled=True)
        return rows, jax.lax.axis_index(AXIS) * x.shape[0] + jnp.arange(x.shape[0])

    each = in_turn if jax.default_backend() == "cpu" else jax.vmap
    across = Across(lambda tree: jax.lax.pmean(tree, AXIS), everyone, each)

    def place(state: Any) -> Any:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (devices, *x.shape)), state)

    def share(batch: Any) -> Any:
        return jax.tree.map(lambda x: np.asarray(x).reshape(devices, len(x) // devices, *np.shape(x)[1:]), batch)

    def first(tree: Any) -> Any:
        # only this host's devices are addressable
        return jax.tree.map(lambda x: x.addressable_data(0).reshape(x.shape[1:]), tree)

    def agreed(state: Any, batch: Any, requests: Array) -> tuple[Any, Any, Array]:
        return *step(state, batch, across), jax.lax.pmax(requests, AXIS)

    alone = jax.process_count() == 1
    compiled = jax.pmap((lambda state, batch: step(state, batch, across)) if alone else agreed, AXIS, donate_argnums=0)

    def run(state: Any, batch: Any, requests: Sequence[bool] = ()) -> tuple[Any, Any, Sequence[Any]]:
        if alone:
            state, report = compiled(state, batch)
            return state, first(report), requests
        state, report, heard = compiled(state, batch, _by_device(requests))
        return state, first(report), np.asarray(first(heard)).tolist()

    return ParallelStep(run, place, share, first if alone else lambda state: jax.tree.map(np.asarray, first(state)))


def _by_device(requests: Sequence[bool]) -> np.ndarray:
    """This host's requests, repeated for each of its devices."""
    return np.tile(np.asarray(requests, np.int32), (jax.local_device_count(), 1))


def _mesh() -> Mesh:
    return Mesh(np.array(jax.devices()), (AXIS,))
