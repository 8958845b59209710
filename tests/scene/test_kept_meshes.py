"""Meshes are kept: read back as they were made, made anew where they are damaged or cannot be kept."""

from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, load_mesh
from mesoshell.io.cache import cache_folder
from mesoshell.scene import kept_meshes
from mesoshell.scene.kept_meshes import ARRAYS, kept_mesh

FILE = Path(__file__).parents[1] / "data" / "suzanne.obj"


@pytest.fixture(autouse=True)
def times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """A cache of its own that keeps small files too; the files that were read."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept_meshes, "MIN_BYTES", 0)
    read: list[Path] = []

    def load(path: Path) -> Mesh:
        read.append(path)
        return load_mesh(path)

    monkeypatch.setattr(kept_meshes, "load_mesh", load)
    return read


def same(a: Mesh, b: Mesh) -> bool:
    return a.notes == b.notes and all(
        getattr(a, name).dtype == getattr(b, name).dtype and np.array_equal(getattr(a, name), getattr(b, name))
        for name in ARRAYS
    )


def test_a_mesh_is_read_once(times: list[Path]):
    first, second = kept_mesh(FILE), kept_mesh(FILE)
    assert len(times) == 1 and same(first, second) and first.notes


def test_another_file_of_the_same_name_is_another_mesh(times: list[Path], tmp_path: Path):
    moved = tmp_path / "m.obj"
    moved.write_bytes(FILE.read_bytes())
    first = kept_mesh(moved)
    moved.write_text(FILE.read_text() + "v 9 9 9\nv 8 9 9\nv 9 8 9\nf -1 -2 -3\n")
    assert len(kept_mesh(moved).faces) == len(first.faces) + 1
    kept_mesh(FILE)
    assert len(times) == 2  # the bytes decide, not the name


def test_small_files_are_not_kept(times: list[Path], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(kept_meshes, "MIN_BYTES", FILE.stat().st_size + 1)
    for _ in range(2):
        kept_mesh(FILE)
    assert len(times) == 2 and not cache_folder("meshes").exists()


@pytest.mark.parametrize("damage", [b"", b"torn", None])
def test_what_is_damaged_is_made_anew(times: list[Path], damage: bytes | None):
    first = kept_mesh(FILE)
    entry = next(cache_folder("meshes").iterdir())
    entry.write_bytes(entry.read_bytes()[:-200] if damage is None else damage)
    assert same(kept_mesh(FILE), first) and len(times) == 2
    assert same(kept_mesh(FILE), first) and len(times) == 2


def test_a_damaged_header_is_made_anew(times: list[Path]):
    """NumPy reads a member's header before its checksum is compared."""
    first = kept_mesh(FILE)
    entry = next(cache_folder("meshes").iterdir())
    entry.write_bytes(entry.read_bytes().replace(b"), }", b")   ", 1))
    assert same(kept_mesh(FILE), first) and len(times) == 2


def test_a_cache_that_cannot_be_written_is_done_without(times: list[Path], tmp_path: Path):
    (tmp_path / "cache").write_text("a file")
    assert len(kept_mesh(FILE).faces) and len(kept_mesh(FILE).faces) and len(times) == 2


def test_a_cache_that_cannot_be_touched_is_read(times: list[Path], monkeypatch: pytest.MonkeyPatch):
    def refused(*_: object) -> None:
        raise PermissionError

    first = kept_mesh(FILE)
    monkeypatch.setattr("os.utime", refused)
    assert same(kept_mesh(FILE), first) and same(kept_mesh(FILE), first) and len(times) == 1


def test_what_was_not_used_for_longest_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    kept_mesh(FILE)
    one = next(cache_folder("meshes").iterdir())
    monkeypatch.setattr(kept_meshes, "MAX_BYTES", round(1.5 * one.stat().st_size))
    other = tmp_path / "m.obj"
    other.write_text(FILE.read_text() + "# another\n")
    kept_mesh(other)
    assert not one.exists() and len(list(cache_folder("meshes").iterdir())) == 1


def test_a_fault_is_said_and_nothing_kept(tmp_path: Path):
    bad = tmp_path / "bad.obj"
    bad.write_text("v 0 0 0\nf 1 2 3\n")
    for path in (bad, tmp_path / "missing.obj"):
        with pytest.raises(InputError, match=str(path)):
            kept_mesh(path)
    assert not cache_folder("meshes").exists()
