"""Grown textures are kept: read back as they were made, bounded, made anew where they are damaged or cannot be kept."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.io import cache, kept_textures
from mesoshell.io.bundle import Bundle
from mesoshell.io.cache import cache_folder, forget, held
from mesoshell.io.kept_textures import Allocate, kept, key_of


@pytest.fixture(autouse=True)
def _small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 0)


@pytest.fixture
def maker(tiny_bundle: Bundle) -> tuple[Callable[[Allocate | None], Bundle], list[bool]]:
    """Fills the bundle's arrays anew, and notes each time whether they are to be kept."""
    times: list[bool] = []

    def make(allocate: Allocate | None) -> Bundle:
        times.append(allocate is not None)
        arrays = dict(tiny_bundle.arrays)
        for name in ("features", "height", "grid"):
            levels = [array for key, array in arrays.items() if key.startswith(f"{name}/")]
            shapes = [x.shape for x in levels]
            new = [np.zeros(s, np.float16) for s in shapes] if allocate is None else allocate(name, shapes)
            for i, (empty, level) in enumerate(zip(new, levels, strict=True)):
                empty[:] = level
                arrays[f"{name}/{i}"] = empty
        return replace(tiny_bundle, arrays=arrays)

    return make, times


def test_a_texture_is_made_once(maker, tiny_bundle: Bundle):
    make, times = maker
    first, second = kept("a", 1000, make), kept("a", 1000, make)
    assert times == [True]
    for found in (first, second):
        assert found.arrays.keys() == tiny_bundle.arrays.keys() and found.parameters == tiny_bundle.parameters
        for key, array in tiny_bundle.arrays.items():
            np.testing.assert_array_equal(found.arrays[key], array)
    kept("b", 1000, make)
    assert times == [True, True] and held(cache_folder("grown")) > 1000


def test_small_and_vast_ones_and_a_full_disk_are_not_kept(maker, monkeypatch: pytest.MonkeyPatch):
    make, times = maker
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 10)
    for size in (9, kept_textures.MAX_BYTES // 2 + 1):
        kept("a", size, make)
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda path: _Full)
    kept("a", 1000, make)
    assert times == [False, False, False] and not cache_folder("grown").exists()


class _Full:
    free = 2999


def test_what_is_damaged_is_made_anew(maker):
    make, times = maker
    kept("a", 1000, make)
    (cache_folder("grown") / "a" / "features.npy").write_bytes(b"torn")
    found = kept("a", 1000, make)
    assert times == [True, True] and np.isfinite(found.arrays["features/0"]).all()
    kept("a", 1000, make)
    assert times == [True, True]


def test_a_cache_that_cannot_be_written_is_done_without(maker, tmp_path: Path):
    (tmp_path / "mesoshell").write_text("a file")
    make, times = maker
    kept("a", 1000, make)
    assert times[-1] is False


def test_what_another_process_removes_meanwhile_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in "abc":
        (tmp_path / name).write_bytes(bytes(10))
    plain = Path.stat

    def stat(path: Path, **how: Any) -> os.stat_result:
        if path.name == "b":
            path.unlink(missing_ok=True)
        return plain(path, **how)

    monkeypatch.setattr(Path, "stat", stat)
    forget(tmp_path, 15, tmp_path / "c")
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def test_a_room_that_cannot_be_read_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    forget(tmp_path / "nothing", 0)
    (tmp_path / "a").write_bytes(bytes(10))

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)
    forget(tmp_path, 0)
    assert (tmp_path / "a").exists()


def test_what_another_process_is_writing_stays(tmp_path: Path):
    for name in (".a", ".b", "c", "d"):
        (tmp_path / name).write_bytes(bytes(10))
    os.utime(tmp_path / ".b", (1000.0, 1000.0))  # left behind
    os.utime(tmp_path / "c", (2000.0, 2000.0))
    forget(tmp_path, 10, tmp_path / "d")
    assert {p.name for p in tmp_path.iterdir()} == {".a", "d"}


def test_a_read_only_cache_serves(maker, monkeypatch: pytest.MonkeyPatch):
    make, times = maker
    kept("a", 1000, make)

    def refuse(path: Path) -> None:
        raise PermissionError(f"{path} is read only")

    monkeypatch.setattr(os, "utime", refuse)
    kept("a", 1000, make)
    assert times == [True]


def test_what_was_not_used_for_longest_goes(maker, monkeypatch: pytest.MonkeyPatch):
    make, _ = maker
    for age, key in enumerate("abc"):
        kept(key, 1000, make)
        os.utime(cache_folder("grown") / key, (1000.0 + age, 1000.0 + age))
    kept("a", 1000, make)  # used again: now the newest
    one = held(cache_folder("grown") / "a")
    monkeypatch.setattr(kept_textures, "MAX_BYTES", round(3.5 * one))
    kept("d", 1000, make)
    assert {p.name for p in cache_folder("grown").iterdir()} == {"a", "c", "d"}


def test_all_that_a_texture_depends_on_is_in_its_key(tiny_bundle: Bundle):
    beta = np.zeros(2, np.float32)
    changed = dict(tiny_bundle.arrays)
    changed["sigma_scale"] = changed["sigma_scale"] + np.float32(1)
    keys = [
        key_of(tiny_bundle, beta, (4, 4), 0),
        key_of(tiny_bundle, beta, (4, 4), 1),
        key_of(tiny_bundle, beta, (4, 8), 0),
        key_of(tiny_bundle, beta + 1, (4, 4), 0),
        key_of(tiny_bundle, np.zeros((1, 2), np.float32), (4, 4), 0),
        key_of(replace(tiny_bundle, arrays=changed), beta, (4, 4), 0),
    ]
    assert len(set(keys)) == len(keys) and keys[0] == key_of(tiny_bundle, beta.copy(), (4, 4), 0)
