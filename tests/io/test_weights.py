"""PyTorch's files, written by hand in both formats: tensors come out, nothing that they name is run."""

import pickle
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.weights import read_weights

MAGIC = 0x1950A86A20F9469CFC6C


class Named:
    """Pickled as a global of this module and name."""

    def __init__(self, module: str, name: str):
        self.module, self.name = module, name


class Tensor:
    def __init__(self, key, count, offset, shape, strides, kind="FloatStorage"):
        self.key, self.count, self.offset, self.shape, self.strides, self.kind = (
            key,
            count,
            offset,
            shape,
            strides,
            kind,
        )


def pickled(obj) -> bytes:
    return pickle.PROTO + b"\x02" + opcodes(obj) + pickle.STOP


def opcodes(obj) -> bytes:
    """What a pickle of tuples, dictionaries, lists, numbers, text, tensors and named things is made of."""
    if isinstance(obj, Named):
        return f"c{obj.module}\n{obj.name}\n".encode()
    if isinstance(obj, Tensor):
        pid = opcodes(("storage", Named("torch", obj.kind), obj.key, "cpu", obj.count)) + pickle.BINPERSID
        rest = b"".join(opcodes(x) for x in (obj.offset, obj.shape, obj.strides, False, {}))
        return (
            opcodes(Named("torch._utils", "_rebuild_tensor_v2"))
            + pickle.MARK
            + pid
            + rest
            + pickle.TUPLE
            + pickle.REDUCE
        )
    if isinstance(obj, tuple):
        return pickle.MARK + b"".join(map(opcodes, obj)) + pickle.TUPLE
    if isinstance(obj, list):
        return pickle.EMPTY_LIST + pickle.MARK + b"".join(map(opcodes, obj)) + pickle.APPENDS
    if isinstance(obj, dict):
        pairs = b"".join(opcodes(k) + opcodes(v) for k, v in obj.items())
        return pickle.EMPTY_DICT + pickle.MARK + pairs + pickle.SETITEMS
    return pickle.dumps(obj, 2)[2:-1]


def old(path: Path, named, storages: dict[str, np.ndarray]) -> Path:
    parts = [pickled(x) for x in (MAGIC, 1001, {}, named, list(storages))]
    data = b"".join(parts) + b"".join(struct.pack("<q", x.size) + x.tobytes() for x in storages.values())
    path.write_bytes(data)
    return path


def new(path: Path, named, storages: dict[str, np.ndarray]) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("archive/data.pkl", pickled(named))
        for key, x in storages.items():
            file.writestr(f"archive/data/{key}", x.tobytes())
    return path


@pytest.mark.parametrize("write", [old, new])
def test_views_of_a_storage_come_out(write, tmp_path: Path) -> None:
    x = np.arange(12, dtype=np.float32)
    named = {"whole": Tensor("0", 12, 0, (3, 4), (4, 1)), "turned": Tensor("0", 12, 1, (2, 3), (1, 4))}
    found = read_weights(write(tmp_path / "a.pth", named, {"0": x}))
    np.testing.assert_array_equal(found["whole"], x.reshape(3, 4))
    np.testing.assert_array_equal(found["turned"], x.reshape(3, 4).T[1:3])
    assert found["turned"].flags.writeable and found["turned"].base is None


@pytest.mark.parametrize("write", [old, new])
@pytest.mark.parametrize(
    ("tensor", "fault"),
    [
        (Tensor("0", 12, 6, (3, 4), (4, 1)), "damaged"),
        (Tensor("0", 12, -1, (3,), (1,)), "damaged"),
        (Tensor("0", 12, 0, (3,), (-1,)), "damaged"),
        (Tensor("0", 12, 0, (10**9, 10**9), (10**9, 1)), "damaged"),
        (Tensor("9", 12, 0, (3,), (1,)), "damaged"),
        (Named("os", "system"), "names os.system, which is not part of a state dict"),
        (Named("torch", "CharStorage"), "names torch.CharStorage"),
    ],
)
def test_what_reaches_beyond_is_refused(write, tensor, fault: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.pth", {"a": tensor}, {"0": np.zeros(12, np.float32)})
    with pytest.raises(InputError, match=fault) as caught:
        read_weights(path)
    assert str(caught.value).startswith(f"{path}: cannot be read as PyTorch weights: ") and "\n" not in str(
        caught.value
    )


def test_other_and_cut_files_are_refused(tmp_path: Path) -> None:
    whole = old(tmp_path / "a.pth", {"a": Tensor("0", 4, 0, (4,), (1,))}, {"0": np.zeros(4, np.float32)}).read_bytes()
    for data in (b"", b"PK\x03\x04", whole[:-1], whole[:40], b"\x80\x02K\x01."):
        (tmp_path / "b.pth").write_bytes(data)
        with pytest.raises(InputError, match="cannot be read as PyTorch weights"):
            read_weights(tmp_path / "b.pth")
    with pytest.raises(InputError, match="no such file"):
        read_weights(tmp_path / "c.pth")
