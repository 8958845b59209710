"""Whole files or none: bytes in, bytes out, with one-line faults (standard library only).

A writer makes its file in memory and hands it to `replace_file`: a file beside PATH is written and renamed, so that PATH is
the new file or what it was before. A folder is filled under another name by `new_folder`. Both names are random and created
exclusively: two writers never share one, no link is followed, and a fault removes only what was created here.
"""

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from mesoshell.errors import InputError
from mesoshell.interrupt import arrived

#: Longest part of a name that is kept in the name of its temporary file: file systems take 255 bytes.
_KEPT = 40


def read_file(path: str | PathLike[str]) -> bytes:
    """The file's bytes. Raises InputError if it is missing or unreadable."""
    try:
        with open(path, "rb") as file:
            if stat.S_ISCHR(os.fstat(file.fileno()).st_mode) or stat.S_ISBLK(os.fstat(file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "is a device")  # /dev/zero has no end
            return file.read()
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(path, f"cannot be read: {_reason(error)}") from error


def replace_file(path: str | PathLike[str], data: bytes) -> None:
    """Make `data` the file at `path`. Raises InputError if it cannot be written; then nothing is left of it."""
    made = None
    try:
        _check_target(Path(path))
        made = _beside(Path(path))
        with open(os.open(made, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # or a power cut may leave the name on an empty file
        os.replace(made, path)
    except FileExistsError as error:  # another's file of this random name: it stays
        raise InputError(path, f"cannot be written: {_reason(error)}") from error
    except (OSError, ValueError) as error:
        _forget(made)
        raise InputError(path, f"cannot be written: {_reason(error)}") from error
    except BaseException:  # Ctrl-C, no memory
        _forget(made)
        raise


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a folder to fill, and rename it to `path` at the end. Raises InputError if `path` exists or cannot be written; a
    fault leaves nothing but the parent folders."""
    made = None
    try:
        if os.path.lexists(path):
            raise InputError(path, "exists already")
        path.parent.mkdir(parents=True, exist_ok=True)
        made = _beside(path)
        made.mkdir()
        yield made
        os.rename(made, path)
    except FileExistsError as error:
        raise InputError(path, f"cannot be written: {_reason(error)}") from error
    except InputError as error:
        raise error if made is None else _in_place(error, made, path) from error
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be written: {_reason(error)}") from error
    except BaseException:  # an interrupt is heard, so that what is removed now can be, however long that takes
        arrived()
        raise
    finally:
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)


@contextlib.contextmanager
def move_together(target: Path) -> Iterator[Path]:
    """Yield a folder, and move its files into the folder of `target` at the end; after a fault, move none. Raises InputError if
    they cannot be written."""
    made = _beside(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made.mkdir()
        yield made
        for file in sorted(made.iterdir()):
            os.replace(file, target.with_name(file.name))
    except InputError as error:
        raise _in_place(error, made, target.parent) from error
    except OSError as error:
        raise InputError(target, f"cannot be written: {_reason(error)}") from error
    except BaseException:
        arrived()
        raise
    finally:
        shutil.rmtree(made, ignore_errors=True)


def new_array(path: Path, shape: tuple[int, ...], dtype: type[np.generic]) -> np.memmap:
    """A mapped array (NPY) at a path that does not exist. Its space is reserved first: on a full disk a write to a mapped file
    kills the process. Raises OSError if there is none."""
    with path.open("xb") as file:
        header = {"descr": np.lib.format.dtype_to_descr(np.dtype(dtype)), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        begin = file.tell()
        file.flush()
        os.posix_fallocate(file.fileno(), 0, begin + int(np.prod(shape, dtype=object)) * np.dtype(dtype).itemsize)
    return np.lib.format.open_memmap(path, "r+")


def probe_outputs(paths: Sequence[Path], option: str = "--out") -> None:
    """Raise InputError unless files can be written at all `paths`; called before the work. Missing folders are made when files
    are written, not here."""
    for path in paths:
        if path.name in ("", ".", ".."):
            raise InputError(option, f"{str(path)!r} names no file")
        try:
            _check_target(path)
            folder = next(p for p in path.parents if os.path.lexists(p))
            _probe(folder)
        except (OSError, ValueError) as error:
            raise InputError(path, f"cannot be written: {_reason(error)}") from error


def probe_folder(path: Path, option: str) -> None:
    """Raise InputError unless files can be written in this folder, which need not exist yet."""
    if not str(path) or str(path) == ".":
        raise InputError(option, "names no folder")
    try:
        _probe(next(p for p in (path, *path.parents) if os.path.lexists(p)))
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be written: {_reason(error)}") from error


def _probe(folder: Path) -> None:
    """Raise OSError unless a file can be made in the folder; the file is removed again."""
    made = _beside(folder / "probe")
    os.close(os.open(made, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
    made.unlink()


def _check_target(path: Path) -> None:
    """Raise OSError if a file cannot or must not replace `path`: a folder, a device, a pipe."""
    if "\0" in str(path):
        raise ValueError("its name holds a NUL")
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "Is a directory")
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "is no regular file")
    if len(os.fsencode(path.name)) > 255:
        raise OSError(errno.ENAMETOOLONG, "File name too long")


def left_over(folder: Path) -> list[Path]:
    """Temporary files that killed writers left in a folder, by their names."""
    return [
        p for p in folder.glob(".*.partial") if re.fullmatch(r"\..+\.[0-9a-f]{16}\.partial", p.name) and p.is_file()
    ]


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name[:_KEPT]}.{secrets.token_hex(8)}.partial")


def _in_place(error: InputError, made: Path, path: Path) -> InputError:
    """The same fault, naming `path` and not the temporary folder beside it."""
    source, _, fault = str(error).replace(str(made), str(path)).partition(": ")
    return InputError(source, fault)


def _forget(made: Path | None) -> None:
    if made is not None:
        with contextlib.suppress(OSError):
            made.unlink()


def _reason(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "its folder does not exist"
    return getattr(error, "strerror", None) or str(error)
