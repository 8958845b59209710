"""Limits of memory and seeds, checked before anything is made (standard library only)."""

import contextlib
import operator
import os
import reprlib
import resource
from os import PathLike
from pathlib import Path
from typing import Any

from mesoshell.errors import Argument, InputError

_CGROUP = Path("/sys/fs/cgroup/memory.max")
#: Open files that a process has beside those that it maps.
SPARE = 256


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


def check_seed(seed: int | None, argument: str = "seed") -> None:
    """Raise InputError for a seed that does not fit a random key."""
    if seed is not None and not -(2**31) <= seed < 2**32:
        raise InputError(Argument(argument), f"{seed} must be from -2147483648 to 4294967295: 32 bits")


def checked_latent(latent: Any, name: str, size: int) -> tuple[int, float] | None:
    """Another seed and its share of a material's latent, of `size` numbers; None where that share is 0. Raises InputError."""
    if latent is None:
        return None
    try:
        seed, share = latent
        seed, share = operator.index(seed), float(share)
    except (TypeError, ValueError, OverflowError):
        given = reprlib.repr(latent)
        raise InputError(Argument("latent"), f"must be another seed and its share, not {given}") from None
    check_seed(seed, "latent")
    if not 0 <= share <= 1:
        raise InputError(Argument("latent"), f"the other seed's share must be from 0 to 1, not {share:g}")
    if not size:
        raise InputError(Argument("latent"), f"{name} has no latent z")
    return (seed, share) if share else None


def allow_files(count: int) -> None:
    """Let the process map so many more files, as far as the system lets it raise its limit: NumPy keeps each one open."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and count + SPARE > soft:
        most = count + SPARE if hard == resource.RLIM_INFINITY else min(count + SPARE, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))
