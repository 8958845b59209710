"""Arrays in a zip, numpy.savez_compressed's layout, or in a folder, read without trust (standard library, NumPy).

Member KEY.npy holds array KEY in npy format 1.0. A head is an array's shape and type: what can be checked before data
are unpacked. Memory is bounded by the bytes in the file, not by the sizes that it claims; pickles are refused.
A folder holds KEY.npy, which are memory-mapped, and its manifest, which counts as an array of bytes. Arrays NAME/0, NAME/1, …
may lie one after the other in NAME.npy, a flat one; NAME.json is then the list of their shapes.
Equal arrays make equal files: order, time stamps and flags are fixed (the bytes may differ between versions of zlib).
Arrays that hardly compress, such as features in half precision, are stored: deflating them saved 7% and took half as long as
making them.
"""

import contextlib
import io
import math
import operator
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from os import PathLike
from pathlib import Path

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file, replace_file
from mesoshell.io.level_arrays import split
from mesoshell.io.records import parse_json
from mesoshell.limits import check_memory

#: Bytes of a manifest, at most.
LONGEST_TEXT = 2**24
#: Key, and in a folder the file, of what an archive says of itself as JSON.
MANIFEST = "manifest.json"

Head = tuple[tuple[int, ...], np.dtype]

#: Pieces sampled to decide whether an array is compressed, and the bytes of each.
_BLOCKS, _BLOCK = 16, 4096

_NPY = b"\x93NUMPY\x01\x00"


def read_heads(path: str | PathLike[str]) -> dict[str, Head]:
    """Shape and type of every array. Raises InputError if the file is missing, not a zip, truncated or damaged."""
    if Path(path).is_dir():
        return {key: (array.shape, array.dtype) for key, array in _mapped(Path(path)).items()}
    with _opened(path) as file:
        check_memory(path, "what it holds", sum(info.file_size for info in file.infolist()))
        heads = {info.filename.removesuffix(".npy"): _head(path, file, info) for info in file.infolist()}
        text = heads.get(MANIFEST)
        if text is not None and math.prod(text[0]) > LONGEST_TEXT:
            raise InputError(path, f"its manifest.json is longer than {LONGEST_TEXT >> 20} MiB")
        if len(heads) < len(file.infolist()):
            raise InputError(path, "holds two arrays of one name")
    return heads


def read_arrays(path: str | PathLike[str], keys: Iterable[str]) -> dict[str, np.ndarray]:
    """The arrays of these keys: new and writable, or of a folder mapped and read-only. Raises InputError as `read_heads`, or if
    a checksum is wrong."""
    if Path(path).is_dir():
        arrays = _mapped(Path(path))
        return {key: arrays[key] for key in keys}
    with _opened(path) as file:
        return {key: _unpacked(file, f"{key}.npy") for key in keys}


def write_arrays(path: str | PathLike[str], arrays: dict[str, np.ndarray]) -> None:
    """Write the arrays in the order given, whole or not at all. Raises InputError if the file cannot be written."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
            info = zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            data = member.getvalue()
            info.compress_type = zipfile.ZIP_DEFLATED if _deflates(data) else zipfile.ZIP_STORED
            info.create_system, info.external_attr = 3, 0o644 << 16
            file.writestr(info, data)
    replace_file(path, stream.getvalue())


def _deflates(data: bytes) -> bool:
    """Whether evenly spaced pieces of the data shrink by a tenth or more."""
    step = max(len(data) // _BLOCKS, _BLOCK)
    sample = b"".join(data[i : i + _BLOCK] for i in range(0, len(data), step))
    return len(zlib.compress(sample, 1)) < 0.9 * len(sample)


def _mapped(folder: Path) -> dict[str, np.ndarray]:
    """The folder's arrays, mapped read-only. Raises InputError at the first file that is not an array."""
    arrays, lists = {}, []
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        key = file.relative_to(folder).as_posix()
        if key == MANIFEST:
            arrays[key] = np.frombuffer(read_file(file), np.uint8)
        elif file.suffix == ".json" and file.with_suffix(".npy").is_file():
            lists.append(file)
        elif file.suffix != ".npy":
            raise InputError(
                file,
                "is not part of a material: it holds KEY.npy, NAME.json beside NAME.npy, and manifest.json",
            )
        else:
            try:
                arrays[key.removesuffix(".npy")] = np.load(file, mmap_mode="r", allow_pickle=False)
            except Exception as error:  # NumPy's parser raises half a dozen types
                raise InputError(file, "not an array (.npy), or a truncated or damaged one") from error
    for file in lists:
        name = file.relative_to(folder).as_posix().removesuffix(".json")
        levels = {f"{name}/{i}": level for i, level in enumerate(_levels(file, arrays.pop(name)))}
        for key in levels.keys() & arrays.keys():
            raise InputError(file, f"names {key}, which has a file of its own, too")
        arrays |= levels
    return arrays


def _levels(file: Path, flat: np.ndarray) -> list[np.ndarray]:
    """The arrays that a flat one holds, whose shapes a file lists."""
    text = read_file(file)
    if len(text) > LONGEST_TEXT:
        raise InputError(file, f"is longer than {LONGEST_TEXT >> 20} MiB")
    shapes = parse_json(file, text, "is ")
    try:
        if any(n < 0 for shape in shapes for n in shape):
            raise ValueError
        return split(flat, [tuple(map(operator.index, shape)) for shape in shapes])
    except (TypeError, ValueError) as error:
        raise InputError(file, "is no list of the shapes of arrays, which have as many numbers as its .npy") from error


@contextlib.contextmanager
def _opened(path: str | PathLike[str]) -> Iterator[zipfile.ZipFile]:
    try:
        if Path(path).exists() and not Path(path).is_file():  # a zip's table lies at its end, which a device lacks
            raise InputError(path, "is no regular file")
        with zipfile.ZipFile(path) as file:
            yield file
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except (PermissionError, IsADirectoryError) as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from error
    except Exception as error:  # zipfile, zlib and NumPy's parser raise a dozen types
        raise InputError(path, "not a zip file, or a truncated or damaged one") from error


def _head(path: str | PathLike[str], file: zipfile.ZipFile, info: zipfile.ZipInfo) -> Head:
    with file.open(info) as stream:
        if not info.filename.endswith(".npy") or stream.read(len(_NPY)) != _NPY:
            raise InputError(path, f"member {info.filename!r} is not an array (.npy, format 1.0)")
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        if stream.tell() + math.prod(shape) * dtype.itemsize != info.file_size:
            raise InputError(path, f"member {info.filename!r} is not as long as its shape and type say")
    return shape, dtype


def _unpacked(file: zipfile.ZipFile, name: str) -> np.ndarray:
    data = file.read(name)
    if len(data) != file.getinfo(name).file_size:
        raise zipfile.BadZipFile
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
