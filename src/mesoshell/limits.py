"""Limits of memory and seeds, checked before anything is made (standard library only)."""

import contextlib
import os
import resource
from os import PathLike
from pathlib import Path

from mesoshell.errors import Argument, InputError

_CGROUP = Path("/sys/fs/cgroup/memory.max")


def memory() -> int:
    """Bytes that this process may use: the least of the machine's memory and the process's limits."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    limits += [n for n in resource.getrlimit(resource.RLIMIT_AS)[:1] if n != resource.RLIM_INFINITY]
    with contextlib.suppress(OSError, ValueError):  # no group, or no limit: "max"
        limits.append(int(_CGROUP.read_text()))
    return min(limits)


def check_memory(source: str | PathLike[str], what: str, size: int, there: int | None = None) -> None:
    """Raise InputError if `what` would take more memory than there is. there: what `memory` gave before."""
    there = memory() if there is None else there
    if size > there:
        raise InputError(source, f"{what} would take {size / 2**30:,.1f} GiB; this machine has {there / 2**30:,.1f}")


def check_seed(seed: int | None) -> None:
    """Raise InputError for a seed that does not fit a random key."""
    if seed is not None and not -(2**31) <= seed < 2**32:
        raise InputError(Argument("seed"), f"{seed} must be from -2147483648 to 4294967295: 32 bits")
