"""Arrays in a zip: a container that claims what it does not hold is refused before memory is spent on it."""

import errno
import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.archive import read_arrays, read_heads, write_arrays
from mesoshell.io.atomic import replace_file

DAMAGED = "not a zip file, or a truncated or damaged one"


def npy(array: np.ndarray, version: tuple[int, int] = (1, 0)) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, version=version)
    return stream.getvalue()


def claiming(shape: str) -> bytes:
    """Four bytes of data under a header that claims more."""
    return npy(np.zeros(1, np.float32)).replace(b"(1,), }".ljust(40), f"{shape}, }}".ljust(40).encode())


def archive(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return path


def test_heads_are_shapes_and_types(tmp_path: Path):
    write_arrays(tmp_path / "a.npz", {"a/0": np.zeros((2, 3), np.float16), "b": np.array(1, np.uint8)})
    heads = {"a/0": ((2, 3), np.dtype(np.float16)), "b": ((), np.dtype(np.uint8))}
    assert read_heads(tmp_path / "a.npz") == heads


def test_members_stand_in_order_and_carry_no_time(tmp_path: Path):
    write_arrays(tmp_path / "a.npz", {"b": np.zeros(2), "a": np.ones(2)})
    with zipfile.ZipFile(tmp_path / "a.npz") as file:
        found = [(info.filename, info.date_time, info.compress_type) for info in file.infolist()]
    assert found == [(f"{key}.npy", (1980, 1, 1, 0, 0, 0), zipfile.ZIP_DEFLATED) for key in "ba"]


def test_noise_is_stored_and_what_is_smooth_deflates(tmp_path: Path):
    noise = np.random.default_rng(0).normal(size=2**16).astype(np.float16)
    half = np.concatenate([np.zeros_like(noise), noise])  # as a texture of which half is wanted
    arrays = {"noise": noise, "half": half, "empty": np.zeros((0, 3)), "smooth": np.linspace(0, 1, 2**16, dtype="f2")}
    write_arrays(tmp_path / "a.npz", arrays)
    with zipfile.ZipFile(tmp_path / "a.npz") as file:
        kinds = {info.filename: info.compress_type for info in file.infolist()}
    assert kinds.pop("noise.npy") == zipfile.ZIP_STORED
    assert set(kinds.values()) == {zipfile.ZIP_DEFLATED}
    found = read_arrays(tmp_path / "a.npz", arrays)
    for key, array in arrays.items():
        np.testing.assert_array_equal(found[key], array)


def test_only_the_arrays_asked_for_are_read(tmp_path: Path):
    write_arrays(tmp_path / "a.npz", {"a": np.arange(3), "b": np.arange(4)})
    read = read_arrays(tmp_path / "a.npz", ["b"])
    assert list(read) == ["b"] and read["b"].tolist() == [0, 1, 2, 3]


def test_missing_file_and_folder(tmp_path: Path, fault_of: Callable):
    assert fault_of(read_heads, tmp_path / "a.npz") == "no such file"
    assert read_heads(tmp_path) == {}
    np.save(tmp_path / "a.npy", np.arange(3.0))
    assert read_heads(tmp_path) == {"a": ((3,), np.dtype(np.float64))}
    assert isinstance(read_arrays(tmp_path, ["a"])["a"], np.memmap)
    (tmp_path / "b.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-1])
    with pytest.raises(InputError, match=r"b\.npy: not an array"):
        read_heads(tmp_path)


@pytest.mark.parametrize("data", [b"", b"PK", b"text" * 50, npy(np.zeros(3))])
def test_not_a_zip(tmp_path: Path, fault_of: Callable, data: bytes):
    (tmp_path / "a.npz").write_bytes(data)
    assert fault_of(read_heads, tmp_path / "a.npz") == DAMAGED


@pytest.mark.parametrize("name, data", [("a", npy(np.zeros(1))), ("a.npy", b"text" * 50), ("a.npy", b"")])
def test_members_that_are_no_arrays(tmp_path: Path, fault_of: Callable, name: str, data: bytes):
    path = archive(tmp_path / "a.npz", {name: data})
    assert fault_of(read_heads, path) == f"member {name!r} is not an array (.npy, format 1.0)"


def test_other_npy_versions(tmp_path: Path, fault_of: Callable):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.zeros(1), (2, 0))})
    assert fault_of(read_heads, path) == "member 'a.npy' is not an array (.npy, format 1.0)"


@pytest.mark.parametrize("shape", ["(2,)", "(1000000000000,)", "(-1,)", "(0,)"])
def test_claimed_shapes_are_measured(tmp_path: Path, fault_of: Callable, shape: str):
    path = archive(tmp_path / "a.npz", {"a.npy": claiming(shape)})
    assert fault_of(read_heads, path) == "member 'a.npy' is not as long as its shape and type say"


@pytest.mark.parametrize("shape", ["(10**12,)", "(x,)", "1", "(1.5,)", "("])
def test_headers_that_are_no_shapes(tmp_path: Path, fault_of: Callable, shape: str):
    path = archive(tmp_path / "a.npz", {"a.npy": claiming(shape)})
    assert fault_of(read_heads, path) == DAMAGED


def test_a_claimed_size_is_not_allocated(tmp_path: Path, fault_of: Callable):
    """Header and zip directory agree on 400 MB; the file holds 4 bytes of data."""
    claimed = 400 * 2**20
    member = claiming(f"({claimed // 4},)")
    path = archive(tmp_path / "a.npz", {"a.npy": member})
    held, said = len(member).to_bytes(4, "little"), (len(member) - 4 + claimed).to_bytes(4, "little")
    path.write_bytes(path.read_bytes().replace(held, said))
    assert read_heads(path) == {"a": ((claimed // 4,), np.dtype(np.float32))}
    tracemalloc.start()
    try:
        assert fault_of(read_arrays, path, ["a"]) == DAMAGED
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()


def test_pickles_are_refused(tmp_path: Path, fault_of: Callable):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.array([{}], object))})
    assert fault_of(read_heads, path) == "member 'a.npy' is not as long as its shape and type say"


def test_a_name_that_occurs_twice(tmp_path: Path, fault_of: Callable):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.zeros(1)), "b.npy": npy(np.zeros(1))})
    path.write_bytes(path.read_bytes().replace(b"b.npy", b"a.npy"))
    assert fault_of(read_heads, path) == "holds two arrays of one name"


def test_an_encrypted_member(tmp_path: Path, fault_of: Callable):
    path = archive(tmp_path / "a.npz", {"a.npy": npy(np.zeros(1))})
    path.write_bytes(path.read_bytes().replace(b"PK\x01\x02\x14\x03\x14\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01"))
    assert fault_of(read_heads, path) == DAMAGED


def test_writing_into_no_folder_and_over_a_folder(tmp_path: Path, fault_of: Callable):
    (tmp_path / "a.npz").mkdir()
    arrays = {"a": np.zeros(1)}
    assert fault_of(write_arrays, tmp_path / "none" / "a.npz", arrays) == "cannot be written: its folder does not exist"
    assert fault_of(write_arrays, tmp_path / "a.npz", arrays) == "cannot be written: Is a directory"
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_full_disk_leaves_the_old_file(tmp_path: Path, fault_of: Callable, monkeypatch: pytest.MonkeyPatch):
    def refuse(handle: int):
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "a.npz").write_bytes(b"old")
    monkeypatch.setattr("os.fsync", refuse)
    fault = fault_of(write_arrays, tmp_path / "a.npz", {"a": np.zeros(1)})
    assert fault == "cannot be written: No space left on device"
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.npz", b"old")]


def test_a_failed_rename_leaves_no_partial_file(tmp_path: Path, fault_of: Callable, monkeypatch: pytest.MonkeyPatch):
    def refuse(source: object, target: object):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("os.replace", refuse)
    assert fault_of(replace_file, tmp_path / "a.json", b"{}") == "cannot be written: Permission denied"
    assert not list(tmp_path.iterdir())


def _folder(path: Path, shapes: str, flat: np.ndarray) -> Path:
    (path / "a").mkdir(parents=True)
    np.save(path / "a.npy", flat)
    (path / "a.json").write_text(shapes)
    np.save(path / "a/9.npy", np.zeros(3))
    return path


def test_levels_share_a_file_of_a_folder(tmp_path: Path):
    folder = _folder(tmp_path / "f", "[[2, 3], [1, 3]]", np.arange(9, dtype=np.float16))
    half = np.dtype(np.float16)
    assert read_heads(folder) == {"a/0": ((2, 3), half), "a/1": ((1, 3), half), "a/9": ((3,), np.dtype(np.float64))}
    found = read_arrays(folder, ["a/1", "a/0"])
    np.testing.assert_array_equal(found["a/0"], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(found["a/1"], [[6, 7, 8]])


@pytest.mark.parametrize(
    "shapes", ["", "3", "[3]", '{"a": 1}', "[[2, 3]]", "[[2, 3], [1, 4]]", "[[9.0]]", "[[-3, -3]]", "[[true]]", "null"]
)
def test_a_list_of_other_shapes_is_refused(shapes: str, tmp_path: Path):
    folder = _folder(tmp_path / "f", shapes, np.arange(9, dtype=np.float16))
    with pytest.raises(InputError, match=r"a\.json: is (no list of the shapes|not JSON)"):
        read_heads(folder)


def test_a_damaged_header_of_a_folder_is_refused(tmp_path: Path, fault_of: Callable):
    (tmp_path / "f").mkdir()
    (tmp_path / "f/a.npy").write_bytes(claiming("("))
    with pytest.raises(InputError, match=r"a\.npy: not an array \(\.npy\), or a truncated or damaged one"):
        read_heads(tmp_path / "f")


def test_an_array_has_one_file(tmp_path: Path):
    folder = _folder(tmp_path / "f", f"[{', '.join(['[1]'] * 10)}]", np.arange(10, dtype=np.float16))
    with pytest.raises(InputError, match=r"a\.json: names a/9, which has a file of its own, too"):
        read_heads(folder)
