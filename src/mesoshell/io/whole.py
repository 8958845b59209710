"""Whole files or none: bytes in, bytes out, with one-line faults (standard library only; floor 2).

A writer makes its file in memory and hands it to `replace_file`: PATH.partial is written and renamed, so that PATH is
the new file or what it was before. Encoders never see the suffix `.partial`, and the system reports a full disk.
"""

import contextlib
import os
from os import PathLike
from pathlib import Path

from mesoshell.errors import InputError


def read_file(path: str | PathLike[str]) -> bytes:
    """The file's bytes. Raises InputError if it is missing or unreadable."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from error


def replace_file(path: str | PathLike[str], data: bytes) -> None:
    """Make `data` the file at `path`. Raises InputError if it cannot be written; then no PATH.partial is left."""
    partial = Path(f"{os.fspath(path)}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # or a power cut may leave the name on an empty file
        os.replace(partial, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        fault = "its folder does not exist" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(path, f"cannot be written: {fault}") from error
