"""Temporary files harm nobody: what lies beside an output stays, links are not followed, writers do not meet."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.atomic import move_together, new_array, new_folder, probe_outputs, replace_file


def test_what_lies_beside_an_output_stays(tmp_path: Path):
    (tmp_path / "victim").write_bytes(b"mine")
    (tmp_path / "a.png.partial").symlink_to("victim")
    (tmp_path / "d.partial").mkdir()
    (tmp_path / "d.partial" / "mine").write_bytes(b"mine")
    replace_file(tmp_path / "a.png", b"new")
    with new_folder(tmp_path / "d") as folder:
        (folder / "x").write_bytes(b"x")
    assert (tmp_path / "victim").read_bytes() == b"mine" and (tmp_path / "a.png").read_bytes() == b"new"
    assert (tmp_path / "d.partial" / "mine").read_bytes() == b"mine" and (tmp_path / "d" / "x").exists()
    assert len(list(tmp_path.iterdir())) == 5


def test_many_writers_of_one_file_never_fail(tmp_path: Path):
    faults = []

    def write(k: int):
        try:
            for _ in range(20):
                replace_file(tmp_path / "one", bytes([k]) * 5000)
        except InputError as fault:
            faults.append(fault)

    threads = [threading.Thread(target=write, args=(k,)) for k in range(6)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    found = (tmp_path / "one").read_bytes()
    assert not faults and found == found[:1] * 5000 and len(list(tmp_path.iterdir())) == 1


def test_a_guessed_name_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Even where the random part is known, another's link is neither followed nor removed."""
    monkeypatch.setattr("mesoshell.io.atomic.secrets.token_hex", lambda n: "0")
    (tmp_path / "victim").write_bytes(b"mine")
    (tmp_path / ".a.0.partial").symlink_to("victim")
    with pytest.raises(InputError, match="cannot be written: File exists"):
        replace_file(tmp_path / "a", b"new")
    assert (tmp_path / ".a.0.partial").is_symlink() and (tmp_path / "victim").read_bytes() == b"mine"


def test_an_interrupt_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def stop(handle: int):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "a", b"new")
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "d"):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


MAPPED = """
import sys, resource, numpy as np
from pathlib import Path
from mesoshell.errors import InputError
from mesoshell.io.atomic import new_array, new_folder
resource.setrlimit(resource.RLIMIT_FSIZE, (2**20, 2**20))
try:
    with new_folder(Path(sys.argv[1])) as folder:
        new_array(folder / "a.npy", (2**20,), np.float16)[:] = 1
except InputError as fault:
    sys.exit(f"{fault}")
"""


def test_a_mapped_file_reserves_its_space(tmp_path: Path):
    """A file that may not grow stands for a full disk: the reservation fails in one line, no write to the map does."""
    found = subprocess.run([sys.executable, "-c", MAPPED, str(tmp_path / "t")], capture_output=True, text=True)
    assert found.returncode == 1 and found.stderr.count("\n") == 1 and "cannot be written" in found.stderr
    assert not list(tmp_path.iterdir())


def test_a_fault_in_a_folder_is_of_the_place_that_was_asked_for(tmp_path: Path):
    with pytest.raises(InputError) as fault, new_folder(tmp_path / "d") as folder:
        replace_file(folder / "none" / "a", b"new")
    assert str(fault.value).startswith(f"{tmp_path}/d/none/a: cannot be written") and not list(tmp_path.iterdir())


def test_several_files_are_all_or_none(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(b"old")
    with (
        pytest.raises(InputError, match=r"/none/a.exr: cannot be written: its folder"),
        move_together(tmp_path / "a.png") as folder,
    ):
        replace_file(folder / "a.png", b"new")
        replace_file(folder / "none" / "a.exr", b"new")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.png", b"old")]
    with move_together(tmp_path / "a.png") as folder:
        replace_file(folder / "a.png", b"new")
        replace_file(folder / "a.exr", b"new")
    assert sorted((p.name, p.read_bytes()) for p in tmp_path.iterdir()) == [("a.exr", b"new"), ("a.png", b"new")]


def test_a_reserved_array_is_an_ordinary_one(tmp_path: Path):
    array = new_array(tmp_path / "a.npy", (3, 4), np.float16)
    array[:] = np.arange(12).reshape(3, 4)
    array.flush()
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), np.arange(12).reshape(3, 4))


@pytest.mark.parametrize("name", ["/dev/null/x.png", "/dev/full", "", ".", "folder", "file/x.png", "n" * 300, "a\0b"])
def test_an_output_that_cannot_be_written_is_known_before(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError) as fault:
        probe_outputs((Path(name),))
    assert "\n" not in str(fault.value)
    assert sorted(os.listdir()) == ["file", "folder"]


def test_probing_leaves_no_trace_and_makes_no_folder(tmp_path: Path):
    probe_outputs((tmp_path / "new" / "folder" / "a.png", tmp_path / "b.png"))
    assert not list(tmp_path.iterdir())


def test_devices_are_never_replaced(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="is no regular file"):
        replace_file(tmp_path / "pipe", b"x")
    assert (tmp_path / "pipe").is_fifo()
