"""A folder that one run writes into at a time (standard library only)."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from mesoshell.errors import InputError


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder, made if missing, for this run alone. Raises InputError if it cannot be made, or another run holds it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(folder, "another run is writing into it") from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(handle)
