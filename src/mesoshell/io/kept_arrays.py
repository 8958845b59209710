"""Arrays kept in a file of the cache: read back whole, or not at all (io/cache)."""

import contextlib
import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io import archive
from mesoshell.io.atomic import replace_file
from mesoshell.io.cache import forget, remove


def keep_arrays(entry: Path, arrays: Mapping[str, np.ndarray], most: int) -> None:
    """Write an entry if it can be written; then remove the least recently used others until all are within `most` bytes."""
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **arrays)
    try:
        entry.parent.mkdir(parents=True, exist_ok=True)
        replace_file(entry, data.getvalue())
        forget(entry.parent, most, entry)
    except (InputError, OSError):  # no such disk, or a full one
        return


def read_arrays(entry: Path, names: Iterable[str]) -> dict[str, np.ndarray] | None:
    """An entry that is there and whole; what is damaged is removed."""
    if not entry.exists():
        return None
    try:
        arrays = archive.read_arrays(entry, names)
    except InputError:
        remove(entry)
        return None
    with contextlib.suppress(OSError):  # of a cache that is read only
        os.utime(entry)
    return arrays
