"""How many devices there are, and how a step is spread over them. No other file knows.

Alphabet
D           devices; each takes an equal share of a step's rays, and all hold the same parameters
g           gradient; the step's is the mean over devices of each device's own: pmean(grad(loss)), since grad(pmean(loss))
            inside a mapped function counts every device's cotangent again

One CPU is split into as many devices as it has cores: within one device the loops of this work run on one core.
"""

import os
from collections.abc import Callable

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

AXIS = "rays"


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


def _mesh() -> Mesh:
    return Mesh(np.array(jax.devices()), (AXIS,))
