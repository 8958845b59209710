"""A folder of queries: it is read in the order of its numbers, and each fault is one line; and the collector that writes it."""

import io
import json
from pathlib import Path

import numpy as np
import pytest

from mesoshell.io.dataset_writer import collecting
from mesoshell.io.query_dataset import COLUMNS, read_patches

NO_DATASET = "its manifest.json or samples.jsonl does not describe a dataset"


def queries(index: int) -> np.ndarray:
    return (np.arange(5 * len(COLUMNS)).reshape(5, -1) + 1000 * index).astype(np.float32)


@pytest.fixture
def patches(tmp_path: Path) -> Path:
    """Three patches, whose rows come in another order."""
    folder = tmp_path / "set"
    (folder / "patches").mkdir(parents=True)
    (folder / "manifest.json").write_text(json.dumps({"schema": 1, "kind": "patches", "source": "weave", "count": 3}))
    rows = []
    for index in (10, 2, 7):
        np.save(folder / f"patches/{index:06d}.npy", queries(index))
        rows.append(json.dumps({"index": index, "file": f"patches/{index:06d}.npy", "sha256": "", "curvature": 0.5}))
    (folder / "samples.jsonl").write_text("\n".join(rows) + "\n")
    return folder


def as_npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def as_npz(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, array)
    return stream.getvalue()


def test_patches_come_by_their_numbers(patches: Path):
    found = read_patches(str(patches))
    assert found.folder == patches and found.manifest["source"] == "weave"
    for index, patch in zip((2, 7, 10), found.patches, strict=True):
        assert isinstance(patch, np.memmap) and patch.dtype == np.float32
        np.testing.assert_array_equal(patch, queries(index))


def test_columns_are_what_the_head_of_the_file_says():
    expected = "u v radius wx wy wz kappa lx ly lz alpha cosine r g b patch"
    assert list(COLUMNS) == expected.split()


def test_a_missing_folder(fault_of, patches: Path):
    assert fault_of(read_patches, patches / "none") == "no such folder"
    assert fault_of(read_patches, patches / "manifest.json") == "no such folder"


@pytest.mark.parametrize("name", ["manifest.json", "samples.jsonl"])
def test_a_file_that_is_not_there_is_named(fault_of, patches: Path, name: str):
    (patches / name).unlink()
    assert fault_of(lambda _: read_patches(patches), patches / name) == "no such file"


@pytest.mark.parametrize("text", ["", "{", "[1]", "3", '"kind"', "null", '{"schema": 1}', "\xff"])
def test_a_manifest_that_is_none(fault_of, patches: Path, text: str):
    (patches / "manifest.json").write_bytes(text.encode("latin-1"))
    assert fault_of(read_patches, patches) == NO_DATASET


@pytest.mark.parametrize(
    "line",
    [
        "{",
        '{"index": 4}',
        '{"file": "patches/000002.npy"}',
        "4",
        '{"index": "a", "file": "b"}',
        '{"index": 3, "file": 4}',
    ],
)
def test_a_row_that_is_none(fault_of, patches: Path, line: str):
    with (patches / "samples.jsonl").open("a") as file:
        file.write(line + "\n")
    assert fault_of(read_patches, patches) == NO_DATASET


def test_a_dataset_of_another_kind(fault_of, patches: Path):
    (patches / "manifest.json").write_text('{"kind": "shards"}')
    said = "holds shards, not queries of patches: make these with mesoshell dataset render-patches"
    assert fault_of(read_patches, patches) == said


def test_a_folder_without_patches_yet(fault_of, patches: Path):
    (patches / "samples.jsonl").write_text("")
    assert fault_of(read_patches, patches) == "has no patches yet"


def test_a_patch_that_is_not_there(fault_of, patches: Path):
    path = patches / "patches/000007.npy"
    path.unlink()
    assert fault_of(lambda _: read_patches(patches), path) == "no such file"
    path.mkdir()
    assert fault_of(lambda _: read_patches(patches), path) == "cannot be read: Is a directory"


@pytest.mark.parametrize("data", [b"", b"hello", as_npy(queries(0))[:40], as_npy(queries(0))[:-4], b"\x93NUMPY"])
def test_a_patch_that_is_cut_off(fault_of, patches: Path, data: bytes):
    path = patches / "patches/000007.npy"
    path.write_bytes(data)
    assert fault_of(lambda _: read_patches(patches), path) == "not a NumPy array, or a truncated one"


@pytest.mark.parametrize(
    "array",
    [
        queries(0).astype(np.float64),
        queries(0).astype(">f4"),
        queries(0)[:, :15],
        queries(0)[0],
        queries(0)[None],
        np.float32(3),
    ],
)
def test_a_patch_of_another_form(fault_of, patches: Path, array: np.ndarray):
    path = patches / "patches/000007.npy"
    path.write_bytes(as_npy(np.asarray(array)))
    assert fault_of(lambda _: read_patches(patches), path) == "is not float32 (Q, 16)"


@pytest.mark.parametrize("data", [as_npz(queries(0)), as_npy(np.array([{}, None]))])
def test_a_patch_that_is_an_archive_or_holds_objects(fault_of, patches: Path, data: bytes):
    path = patches / "patches/000007.npy"
    path.write_bytes(data)
    assert fault_of(lambda _: read_patches(patches), path) == "not a NumPy array, or a truncated one"


def test_a_collector_keeps_its_files_where_it_is_told(tmp_path: Path, fault_of):
    """What was half-written there goes; the folder of another kind of dataset, and what is of another name, are left alone."""
    folder = tmp_path / "set"
    for name in ("patches", "images"):
        (folder / name).mkdir(parents=True)
        (folder / name / ".000001.npy.0123456789abcdef.partial").write_bytes(b"half")
    mine = folder / "patches/mine.partial"
    mine.write_bytes(b"mine")
    (folder / "manifest.json").write_text('{"count": 2}')
    with collecting(folder, {}, 3, "patches") as collector:
        assert collector.missing(3) == [0, 1, 2]
        assert list((folder / "patches").iterdir()) == [mine] and mine.read_bytes() == b"mine"
        assert len(list((folder / "images").iterdir())) == 1
        (folder / "patches/000001.npy").write_bytes(b"")
        collector.add({"index": 1, "file": "patches/000001.npy"}, None)
    with collecting(folder, {}, 3, "patches") as collector:
        assert collector.missing(3) == [0, 2]


def test_a_collector_makes_its_folder_of_files(tmp_path: Path):
    with collecting(tmp_path / "a", {}, 1, "patches"):
        pass
    with collecting(tmp_path / "b", {}, 1):
        pass
    assert (tmp_path / "a/patches").is_dir() and not (tmp_path / "a/images").exists()
    assert (tmp_path / "b/images").is_dir() and not (tmp_path / "b/patches").exists()


def test_files_without_a_manifest_are_nobodys(tmp_path: Path, fault_of):
    def opened(folder: Path) -> None:
        with collecting(folder, {}, 1, "patches"):
            pass

    (tmp_path / "patches").mkdir()
    (tmp_path / "patches/000000.npy").write_bytes(b"")
    assert fault_of(opened, tmp_path) == "has samples but no manifest.json: not a dataset folder"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["patches"]
