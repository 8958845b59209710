"""Readers are given files that were cut, flipped, emptied, nested and made up: each is read or refused in one line."""

import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.archive import read_arrays, read_heads, write_arrays
from mesoshell.io.bundle import read_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.dataset_images import load_images
from mesoshell.io.dataset_writer import collecting
from mesoshell.io.image import read_exr, read_heights, read_picture, read_png
from mesoshell.io.material import bundled_materials
from mesoshell.io.poses import read_poses
from mesoshell.io.query_dataset import read_patches
from mesoshell.io.records import read_object, read_rows
from mesoshell.io.surface import read_surface
from mesoshell.io.weights import read_weights
from mesoshell.train.loader import Feed
from mesoshell.train.run_config import read_record

READERS: dict[str, Callable[[Path], Any]] = {
    "ball.obj": load_mesh,
    "ball.ply": load_mesh,
    "ball.stl": load_mesh,
    "ball.glb": load_mesh,
    "ball.off": load_mesh,
    "a.exr": read_exr,
    "a.png": read_png,
    "cameras.npz": read_heads,
}


def tried(read: Callable, *arguments: Any) -> None:
    """Read, or be refused in one line; anything else falls through."""
    try:
        read(*arguments)
    except InputError as fault:
        assert "\n" not in str(fault) and len(str(fault)) < 1200


def damaged(data: bytes, seed: int) -> bytes:
    """Cut, flipped, doubled, zeroed, or with a number of 32 bits made large."""
    random = np.random.default_rng(seed)
    at, way = int(random.integers(len(data))), seed % 5
    if way == 0:
        return data[:at]
    if way == 1:
        return data[:at] + bytes([data[at] ^ (1 << int(random.integers(8)))]) + data[at + 1 :]
    if way == 2:
        return data[:at] + data[at // 2 :]
    if way == 3:
        return data[:at] + bytes(min(64, len(data) - at)) + data[at + 64 :]
    return data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :]


@pytest.mark.filterwarnings("ignore")  # of libraries, about what they read
@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("block", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in (1, 2))])
def test_damaged_files_are_read_or_refused(good: Path, tmp_path: Path, name: str, block: int):
    """480 cases: 20 a block, kind of file."""
    data, path = (good / name).read_bytes(), tmp_path / name
    for seed in range(20 * block, 20 * block + 20):
        path.write_bytes(damaged(data, seed))
        tried(READERS[name], path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"\xff" * 100, b"[" * 5000, "v 0 0 0\n".encode("utf-16")])
@pytest.mark.parametrize("name", [*READERS, "a.jpg", "weights.pth"])
def test_what_is_no_such_file_is_refused(tmp_path: Path, name: str, content: bytes, refuses):
    path = tmp_path / name
    path.write_bytes(content)
    read = READERS.get(name) or (read_weights if name.endswith("pth") else read_picture)
    refuses(read, path)
    if name.endswith("png"):
        refuses(read_heights, path)


@pytest.mark.parametrize("kind", ["ply", "stl", "glb", "off"])
def test_a_mesh_that_is_cut_short_is_called_so(good: Path, tmp_path: Path, kind: str, refuses):
    path = tmp_path / f"a.{kind}"
    path.write_bytes((good / f"ball.{kind}").read_bytes()[:400])
    assert "no faces" not in refuses(load_mesh, path)


def test_a_mesh_says_what_is_wrong_with_it(tmp_path: Path, refuses):
    (tmp_path / "a.stl").write_bytes(bytes(80) + b"\xff\xff\xff\xff" + bytes(100))
    assert "4294967295 faces" in refuses(load_mesh, tmp_path / "a.stl")
    (tmp_path / "a.obj").write_bytes("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode("utf-16"))
    assert "UTF-16" in refuses(load_mesh, tmp_path / "a.obj")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1e30 0 0\nv 0 1e30 0\nf 1 2 3\n")
    assert "vertex 1 lies beyond" in refuses(load_mesh, tmp_path / "a.obj")


#: Of JSON that is read as an object.
TEXTS = {
    "deep": b"[" * 100_000,
    "deep object": b'{"frames":' * 100_000,
    "text": b'"text"',
    "list": b"[1, 2]",
    "null": b"null",
    "empty": b"",
    "torn": b'{"frames": [{"file_path": "a',
    "latin": b'{"frames": "\xe9"}',
    "number": b'{"frames": ' + b"9" * 5000 + b"}",
    "numbers": b'{"frames": [1, 2], "kind": 1, "config": 3, "count": 1e999}',
    "wrong": b'{"method": [], "config": {}, "data": {}, "frames": [{"file_path": 3}], "kind": [], "count": "x"}',
}


@pytest.mark.parametrize("name", TEXTS)
def test_json_of_any_kind_is_refused(tmp_path: Path, name: str, refuses):
    for file in ("manifest.json", "config.json", "transforms.json"):
        (tmp_path / file).write_bytes(TEXTS[name])
    (tmp_path / "samples.jsonl").write_bytes(TEXTS[name])
    for read in (read_dataset, read_patches, read_record, read_poses):
        refuses(read, tmp_path)
    assert check_dataset(tmp_path)
    refuses(lambda: collecting(tmp_path, {}, 3).__enter__())


@pytest.mark.parametrize("name", TEXTS)
def test_bundles_with_any_manifest_are_refused(tmp_path: Path, name: str, refuses):
    from mesoshell.neutex.store import read_neutex

    write_arrays(tmp_path / "a.npz", {"manifest.json": np.frombuffer(TEXTS[name], np.uint8)})
    for read in (read_bundle, read_surface, read_neutex):
        refuses(read, tmp_path / "a.npz")


def test_torn_rows_are_left_out_and_others_named(tmp_path: Path, refuses):
    path = tmp_path / "evaluation.jsonl"
    path.write_text('{"name": "kid"}\n{"name": "ki')
    assert read_rows(path, ("name",)) == [{"name": "kid"}]
    for line in ('{"name": "ki\n', "[]\n", "{}\n", "[" * 50_000 + "\n", "3\n"):
        path.write_text('{"name": "kid"}\n' + line)
        assert "line 2: " in refuses(read_rows, path, ("name",))
    refuses(read_object, tmp_path)


def _changed(good: Path, to: Path, **fields: Any) -> Path:
    """A packed dataset with other fields in all its rows (`row_…`), or its manifest."""
    shutil.copytree(good / "packed", to)
    manifest = json.loads((to / "manifest.json").read_text())
    rows = [json.loads(line) for line in (to / "samples.jsonl").read_text().splitlines()]
    manifest |= {k: v for k, v in fields.items() if not k.startswith("row_")}
    rows = [row | {k.removeprefix("row_"): v for k, v in fields.items() if k.startswith("row_")} for row in rows]
    (to / "manifest.json").write_text(json.dumps(manifest))
    (to / "samples.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return to


FED = {
    "3 channels": (np.ones((3, 4, 6, 3), np.float16), "3 channels"),
    "zeros": (np.zeros((3, 4, 6, 4), np.float16), "zeros alone"),
    "short": (np.ones((2, 4, 6, 4), np.float16), "has no row 2"),
    "another size": (np.ones((3, 5, 6, 4), np.float16), "6 × 5 pixels"),
    "float32": (np.ones((3, 4, 6, 4), np.float32), "expected half"),
    "nan": (np.full((3, 4, 6, 4), np.nan, np.float16), "NaN"),
}


@pytest.mark.parametrize("name", FED)
def test_a_shard_that_cannot_be_learned_from_is_refused(good: Path, tmp_path: Path, name: str, refuses):
    folder = _changed(good, tmp_path / "d")
    np.save(folder / "shards/0000.npy", FED[name][0])
    assert FED[name][1] in refuses(lambda: Feed(read_dataset(folder), 2)[0])
    if name != "zeros":  # which may be shown
        refuses(load_images, read_dataset(folder))


@pytest.mark.parametrize("keep", [0, 10, 100, 200, 400])
def test_a_torn_shard_is_refused(good: Path, tmp_path: Path, keep: int, refuses):
    folder = _changed(good, tmp_path / "d")
    shard = folder / "shards/0000.npy"
    shard.write_bytes(shard.read_bytes()[:keep])
    refuses(lambda: Feed(read_dataset(folder), 2)[0])
    assert check_dataset(folder)


VALUES = [None, -1, 1e308, 10**40, "x", [], {}, True, [10**9, 10**9], [[0] * 4] * 4, "a\0b", "../../x", "n" * 5000]
ROWS = ("index", "row", "file", "size", "camera_to_world", "fov", "light", "parameters", "sha256", "irradiance")


@pytest.mark.parametrize("field", [*(f"row_{name}" for name in ROWS), "size", "count", "parameters", "recipe"])
def test_fields_of_a_dataset_may_be_anything(good: Path, tmp_path: Path, field: str):
    """182 cases."""
    for i, value in enumerate(VALUES):
        folder = _changed(good, tmp_path / str(i), **{field: value})
        tried(lambda folder=folder: load_images(read_dataset(folder)))
        assert check_dataset(folder)


FRAME = ("file_path", "transform_matrix", "fl_x", "w", "h", "mask_path", "camera_angle_x", "k1", "camera_model")


@pytest.mark.parametrize("field", [*FRAME, "ply_file_path", "flash", "frames"])
def test_fields_of_transforms_may_be_anything(good: Path, tmp_path: Path, field: str):
    """156 cases; names with NUL, of 5000 characters and outside the folder among them."""
    from mesoshell.neutex.capture import read_capture

    shutil.copy(good / "a.png", tmp_path)
    for value in VALUES:
        said = json.loads((good / "transforms.json").read_text())
        (said["frames"][0] if field in FRAME else said)[field] = value
        (tmp_path / "transforms.json").write_text(json.dumps(said))
        tried(read_capture, tmp_path, "black", 8)


def test_photographs_may_lie_outside_of_their_capture(good: Path, tmp_path: Path):
    """They are read, wherever they lie; nothing is written there."""
    said = json.loads((good / "transforms.json").read_text())
    said["frames"][0]["file_path"] = f"../{good.name}/a.png"
    folder = good.parent / "capture"
    folder.mkdir()
    (folder / "transforms.json").write_text(json.dumps(said))
    before = (good / "a.png").stat().st_mtime_ns
    (view,) = read_poses(folder).views
    assert read_picture(view.image).shape == (6, 5, 3) and (good / "a.png").stat().st_mtime_ns == before


@pytest.mark.parametrize("count", [10**9, 10**18])
def test_a_count_costs_no_memory(good: Path, tmp_path: Path, count: int):
    folder = _changed(good, tmp_path / "d", count=count)
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["packed"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert any(f"and {count - 11} more" in fault for fault in check_dataset(folder))


BOUNDED = """
import resource, sys
from pathlib import Path
from mesoshell.io.bundle import read_bundle
from mesoshell.io.surface import read_surface
resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
for read in (read_bundle, read_surface):
    try:
        read(Path(sys.argv[1]))
    except ValueError as fault:
        print(fault)
"""


def test_what_an_archive_inflates_to_is_bounded(tmp_path: Path):
    """A member of 600 MB in 600 kB is refused before it is inflated, in a process of 1 GiB."""
    said = b"{'descr': '|u1', 'fortran_order': False, 'shape': (600000000,), }"
    head = b"\x93NUMPY\x01\x00\x76\x00" + said.ljust(117) + b"\n"
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as file,
        file.open("manifest.json.npy", "w", force_zip64=True) as member,
    ):
        member.write(head)
        for _ in range(600):
            member.write(b" " * 10**6)
    found = subprocess.run([sys.executable, "-c", BOUNDED, str(tmp_path / "a.npz")], capture_output=True, text=True)
    assert found.stdout.count("is longer than 16 MiB") == 2, found.stderr


def test_a_material_that_is_damaged_is_refused(tmp_path: Path):
    """40 cases of a bundled material with one byte flipped or its end cut."""
    data, path = bundled_materials()["grass"].read_bytes(), tmp_path / "a.npz"
    for seed in range(40):
        path.write_bytes(damaged(data, seed))
        tried(lambda: read_arrays(path, read_heads(path)))
