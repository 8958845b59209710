"""How many devices there are, and how a step is spread over them. No other file knows.

Alphabet
D           devices; each takes an equal share of a step's rows (rays, pictures), and all hold the same parameters
g           gradient; the step's is the mean over devices of each device's own: pmean(grad(loss)), since grad(pmean(loss))
            inside a mapped function counts every device's cotangent again

One CPU is split into as many devices as it has cores: within one device the loops of this work run on one core.
"""

import os
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from mesoshell.errors import InputError
from mesoshell.train.step import HERE, Across

AXIS = "rows"


def split_cpu() -> None:
    """One device a core; must come before JAX starts. A count that the user has set in XLA_FLAGS stays."""
    flag = "--xla_force_host_platform_device_count"
    flags = os.environ.get("XLA_FLAGS", "")
    if flag not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {flag}={os.cpu_count()}".strip()


def device_count() -> int:
    return len(jax.devices())


def spread(tree):
    """Arrays whose first axis is split over all devices; its length must be a multiple of their number."""
    return jax.device_put(tree, NamedSharding(_mesh(), P(AXIS)))


def replicate(tree):
    """Arrays that every device holds whole."""
    return jax.device_put(tree, NamedSharding(_mesh(), P()))


def mean_gradient(loss: Callable) -> Callable:
    """((parameters, shared, split) → ((value, extra), gradient)) with means over devices, from loss(parameters, shared,
    split) → (value, extra). parameters and shared are whole on every device; split's first axis is shared out."""

    def local(parameters, shared, split):
        found = jax.value_and_grad(loss, has_aux=True)(parameters, shared, split)
        return jax.lax.pmean(found, AXIS)

    return jax.shard_map(local, mesh=_mesh(), in_specs=(P(), P(), P(AXIS)), out_specs=P(), check_vma=False)


class Spread(NamedTuple):
    """A step on all devices of all hosts. place: a state, to every device; share: this host's rows of a batch, to its devices;
    whole: a placed state as arrays that any host can save."""

    step: Callable[[Any, Any], tuple[Any, Any]]
    place: Callable[[Any], Any]
    share: Callable[[Any], Any]
    whole: Callable[[Any], Any]


def spread_step(
    step: Callable[[Any, Any, Across], tuple[Any, Any]], batch: int, how: str = "jit", together: int = 1
) -> Spread:
    """`step` under `jit` with a sharded batch, or under `pmap`. batch: rows of all hosts; together: neighbours that belong
    to each other. Raises InputError if the devices cannot share the rows evenly, or pmap would part neighbours."""
    if batch % device_count() or batch % together:
        raise InputError("batch", f"{batch} is no multiple of the {device_count()} devices and the {together} views")
    if how == "pmap" and batch // device_count() % together:
        raise InputError("batch", f"{batch} leaves {batch // device_count()} to a device, which parts {together} views")
    return _by_pmap(step) if how == "pmap" else _by_jit(step)


def in_turn(f: Callable) -> Callable:
    """f on each row, one after the other: on one CPU pictures stay in its cache, and rays that miss cost nothing."""
    return lambda *rows: jax.lax.map(lambda row: f(*row), rows)


def _by_jit(step: Callable) -> Spread:
    """Arrays are global: the compiler spreads what follows from the batch, and means are over all of it."""
    rows, all_of_it = NamedSharding(_mesh(), P(AXIS)), NamedSharding(_mesh(), P())
    across = HERE._replace(each=in_turn) if jax.default_backend() == "cpu" and device_count() == 1 else HERE
    compiled = jax.jit(lambda state, batch: step(state, batch, across), out_shardings=all_of_it, donate_argnums=0)

    def share(batch: Any) -> Any:
        return jax.tree.map(lambda x: jax.make_array_from_process_local_data(rows, np.asarray(x)), batch)

    return Spread(compiled, replicate, share, lambda state: state)


def _by_pmap(step: Callable) -> Spread:
    """Each device has rows of its own: means and groups are made over all of them by hand."""
    devices = jax.local_device_count()

    def everyone(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        rows = jax.lax.all_gather(x, AXIS, tiled=True)
        return rows, jax.lax.axis_index(AXIS) * x.shape[0] + jnp.arange(x.shape[0])

    across = Across(lambda tree: jax.lax.pmean(tree, AXIS), everyone)
    compiled = jax.pmap(lambda state, batch: step(state, batch, across), AXIS, donate_argnums=0)

    def place(state: Any) -> Any:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (devices, *x.shape)), state)

    def share(batch: Any) -> Any:
        return jax.tree.map(lambda x: np.asarray(x).reshape(devices, len(x) // devices, *np.shape(x)[1:]), batch)

    def first(tree: Any) -> Any:
        return jax.tree.map(lambda x: x[0], tree)

    def run(state: Any, batch: Any) -> tuple[Any, Any]:
        state, report = compiled(state, batch)
        return state, first(report)

    return Spread(run, place, share, first)


def _mesh() -> Mesh:
    return Mesh(np.array(jax.devices()), (AXIS,))
