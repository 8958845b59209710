"""Archives of meshes: one mesh is read with its buffers; none leads out of its folder, or is larger than the memory."""

import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.exchange.gltf import export_gltf

from mesoshell import limits
from mesoshell.errors import InputError
from mesoshell.geometry import unzip
from mesoshell.geometry.mesh import load_mesh
from mesoshell.scene.setup import axis_of_file
from mesoshell.scene.unpack import is_scene_file

DATA = Path(__file__).parents[1] / "data"


def pack(path: Path, files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


def test_a_mesh_is_read_out_of_an_archive(tmp_path: Path):
    plain = load_mesh(DATA / "spot.obj")
    files = {
        "spot/spot.obj": (DATA / "spot.obj").read_bytes(),
        "__MACOSX/spot/._spot.obj": b"x",
        "spot/.spot.obj": b"x",
    }
    zipped = load_mesh(pack(tmp_path / "SPOT.ZIP", files, zipfile.ZIP_DEFLATED))
    for name in ("vertices", "faces", "uv", "normals"):
        np.testing.assert_array_equal(getattr(zipped, name), getattr(plain, name))


def test_a_scene_finds_its_buffers_and_counts_as_one(tmp_path: Path):
    parts = export_gltf(trimesh.Scene(trimesh.creation.box()))
    assert len(parts) > 1
    path = pack(tmp_path / "box.zip", {f"source/{name}": data for name, data in parts.items()} | {"preview.obj": OBJ})
    assert len(load_mesh(path).faces) == 12 and is_scene_file(path) and axis_of_file(path) == 1


def test_up_is_the_file_s(tmp_path: Path):
    trimesh.creation.box().export(tmp_path / "y.dae")
    text = (tmp_path / "y.dae").read_bytes()
    assert b"Y_UP" in text
    (tmp_path / "z.dae").write_bytes(text.replace(b"Y_UP", b"Z_UP"))
    pack(tmp_path / "z.zae", {"a/z.dae": (tmp_path / "z.dae").read_bytes()})
    assert [axis_of_file(tmp_path / name) for name in ("y.dae", "z.dae", "z.zae")] == [1, 2, 2]


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"a.txt": b""}, r"holds no mesh of \.obj, "),
        ({"b.obj": OBJ, "a.obj": OBJ}, r"holds 2 meshes: unpack it, and give one of a\.obj, b\.obj$"),
        ({"../a.obj": OBJ}, r"its file '\.\./a\.obj' leads out of the folder"),
        ({"x\\..\\..\\a.obj": OBJ}, r"leads out of the folder"),
        ({"/a.obj": OBJ}, r"leads out of the folder"),
        ({"C:/a.obj": OBJ}, r"leads out of the folder"),
        ({"a.obj": b"v 0 0\n"}, r"a\.zip/a\.obj: line 1: needs 3 numbers and has 2"),
        ({"a.obj/b.obj": OBJ, "a.obj": OBJ}, r"holds 2 meshes"),
        ({"a": b"x", "a/b.obj": OBJ}, r"cannot be unpacked"),
        ({f"{k}.obj": b"" for k in range(6)}, r"holds 6 files, more than 5"),
        ({".": OBJ}, r"leads out of the folder"),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_line(
    files: dict[str, bytes], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(unzip, "MOST", 5)
    for name in ("in", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    before = set(tmp_path.rglob("*"))
    path = pack(tmp_path / "in" / "a.zip", files)
    with pytest.raises(InputError, match=says) as fault:
        load_mesh(path)
    assert "\n" not in str(fault.value) and "a.zip" in str(fault.value)
    for _, folder, _ in unzip._UNPACKED.values():  # of what could be unpacked
        folder.cleanup()
    unzip._UNPACKED.clear()
    assert set(tmp_path.rglob("*")) == before | {path}


def test_an_archive_larger_than_the_memory_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A gigabyte of spaces is a megabyte in it."""
    monkeypatch.setattr(limits, "memory", lambda: 2**34)
    for kind, name in (("zip", "a.obj"), ("3mf", "3D/3dmodel.model"), ("zae", "a.dae")):
        path = tmp_path / f"bomb.{kind}"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(name, b" " * 2**26)
        data = bytearray(path.read_bytes())
        at = data.rindex(b"PK\x01\x02") + 24  # what the directory says of its size
        data[at : at + 4] = (2**32 - 2).to_bytes(4, "little")
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"what it holds would take 64\.0 GiB"):
            load_mesh(path)


def test_nothing_stays_behind(tmp_path: Path):
    """Nor does what a process unpacked."""
    pack(tmp_path / "a.zip", {"a.obj": OBJ})
    (tmp_path / "tmp").mkdir()
    code = f"from mesoshell.geometry.mesh import load_mesh; print(len(load_mesh({str(tmp_path / 'a.zip')!r}).faces))"
    command = [sys.executable, "-c", code]
    out = subprocess.run(command, env=os.environ | {"TMPDIR": str(tmp_path / "tmp")}, capture_output=True, text=True)
    assert out.stdout == "1\n" and out.stderr == "" and not list((tmp_path / "tmp").iterdir())


def test_an_archive_that_changed_is_read_again(tmp_path: Path):
    path = pack(tmp_path / "a.zip", {"a.obj": OBJ})
    first = load_mesh(path).vertices.max()
    pack(path, {"a.obj": OBJ.replace(b"v 1 0 0", b"v 10 0 0")})
    assert load_mesh(path).vertices.max() == 10 * first
