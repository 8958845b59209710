"""The doctor says what is kept on the disk, and removes that and nothing else."""

from pathlib import Path

import pytest

from mesoshell.cli.commands.doctor import say_kept
from mesoshell.io.cache import ROOMS, cache_folder


def test_what_is_kept_is_said_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for room in ROOMS:
        (cache_folder(room) / "deep").mkdir(parents=True)
        (cache_folder(room) / "deep" / "entry").write_bytes(bytes(3_000_000))
    other = tmp_path / "mesoshell" / "mine.txt"
    other.write_text("not of the cache")
    say_kept(clear=False)
    assert capsys.readouterr().out.count("3 MB of ") == len(ROOMS)
    say_kept(clear=True)
    said = capsys.readouterr().out
    assert said.count("0 MB of ") == len(ROOMS) and str(tmp_path / "mesoshell") in said
    assert [p.name for p in (tmp_path / "mesoshell").iterdir()] == ["mine.txt"] and other.exists()


def test_a_link_is_removed_and_not_what_it_leads_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    kept = tmp_path / "elsewhere"
    kept.mkdir()
    (kept / "file").write_text("stays")
    cache_folder("meshes").parent.mkdir(parents=True)
    cache_folder("meshes").symlink_to(kept)
    say_kept(clear=True)
    assert (kept / "file").exists() and not cache_folder("meshes").is_symlink()
