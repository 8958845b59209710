"""Several hosts that train as one: how they connect, what the first sends to all, and how a lost host is noticed.

Notation
host        a process with devices of its own; only the first, number 0, reads and writes the run's folder
requests    of a host, sent with a step: a stop, a checkpoint; what any host requests, all do, after the same step
lost        a host that sends no heartbeat for LOST_AFTER seconds, or without which a sum over hosts fails

Hosts wait for each other in a step, for the first host's arrays at the start and for its last file at the end, and nowhere
else. No host alone may decide what depends on a clock or a signal: such requests travel with the step (train/parallel).
"""

import contextlib
import re
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from mesoshell.errors import Argument, InputError

#: Seconds without a heartbeat after which a host is lost, and within which all must connect at the start.
LOST_AFTER, JOIN_WITHIN = 60, 300
#: Words in an error that another host, or the connection to it, has caused.
_FOREIGN = re.compile(
    r"\b(gloo|nccl|rccl|coordination service|heartbeats?|unavailable|connection (reset|closed))\b", re.I
)


class HostLost(RuntimeError):
    """Another host is gone, or has stopped with an error that it printed itself."""


def join(coordinator: str, hosts: tuple[int, int] | None) -> None:
    """Connect to the other hosts at HOST:PORT, or, with "auto", where the cluster says. hosts: their count, and this one's
    number. Must come before JAX starts. Raises InputError. JAX ends the process if not all connect within JOIN_WITHIN, or one
    is lost later."""
    count, mine = hosts or (None, None)
    if coordinator != "auto" and not re.fullmatch(r"\S+:\d{1,5}", coordinator):
        raise InputError(Argument("coordinator"), f"must be HOST:PORT or auto, not {coordinator}")
    if coordinator != "auto" and (count is None or mine is None):
        raise InputError(
            Argument("hosts"), "needs the number of hosts and this host's number beside `coordinator` HOST:PORT"
        )
    if count is not None and mine is not None and not 0 <= mine < count:
        raise InputError(Argument("hosts"), f"of {count} hosts none has the number {mine}: they count from 0")
    # this service would handle SIGTERM, by which a run stops in its own way
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(
            None if coordinator == "auto" else coordinator,
            count,
            mine,
            initialization_timeout=JOIN_WITHIN,
            heartbeat_timeout_seconds=LOST_AFTER,
        )
    except (ValueError, TypeError) as error:
        raise InputError(
            Argument("coordinator"), f"no cluster is known here ({error}): give HOST:PORT and `hosts` COUNT NUMBER"
        ) from error
    except RuntimeError as error:
        raise InputError(Argument("coordinator"), f"{coordinator}: {error}") from error
    # on CPUs the first connection to a host waits only half a minute; connect before slow work begins
    with noticing():
        multihost_utils.sync_global_devices("the beginning of a run")


def is_first() -> bool:
    """Whether this is host 0, which alone writes."""
    return jax.process_index() == 0


def broadcast_first(tree: Any) -> Any:
    """The first host's arrays, bit for bit, on all hosts (as NumPy's); with one host, the tree as it is."""
    if jax.process_count() == 1:
        return tree
    leaves, structure = jax.tree.flatten(tree)
    leaves = [np.asarray(x) for x in leaves]
    sent = np.concatenate([np.frombuffer(x.tobytes(), np.uint8) for x in leaves])
    got = np.asarray(multihost_utils.broadcast_one_to_all(sent)).tobytes()
    ends = np.cumsum([0] + [x.nbytes for x in leaves])
    parts = [np.frombuffer(got[a:b], x.dtype).reshape(x.shape) for a, b, x in zip(ends, ends[1:], leaves, strict=False)]
    return jax.tree.unflatten(structure, parts)


def wait_for_all() -> None:
    """Wait until every host is here: the others would count one that left sooner as lost."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices("the end of a run")


@contextlib.contextmanager
def noticing() -> Iterator[None]:
    """Raise HostLost for an error in a sum over hosts that another host caused."""
    try:
        yield
    except (RuntimeError, ValueError) as error:
        foreign = isinstance(error, jax.errors.JaxRuntimeError) or type(error) is ValueError  # gloo's, on a CPU
        if jax.process_count() == 1 or not foreign or not _FOREIGN.search(str(error)):
            raise
        raise HostLost(str(error)) from error
