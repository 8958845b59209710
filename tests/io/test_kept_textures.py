"""Grown textures are kept: read back as they were made, bounded, made anew where they are damaged or cannot be kept."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io import kept_textures
from mesoshell.io.bundle import Bundle
from mesoshell.io.cache import cache_folder, forget, held
from mesoshell.io.kept_textures import Allocate, Make, Tiles, kept, key_of

ALL = np.ones((2, 3), bool)


@pytest.fixture(autouse=True)
def _small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 0)


@pytest.fixture
def maker(tiny_bundle: Bundle) -> tuple[Make, list[bool]]:
    """Fills the bundle's arrays anew, and notes each time whether they are to be kept."""
    times: list[bool] = []

    def make(allocate: Allocate | None, tiles: Tiles, there: Tiles) -> Bundle:
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
    first, second = kept("a", 1000, make, ALL), kept("a", 1000, make, ALL)
    assert times == [True]
    for found in (first, second):
        assert found.arrays.keys() == tiny_bundle.arrays.keys() and found.parameters == tiny_bundle.parameters
        for key, array in tiny_bundle.arrays.items():
            np.testing.assert_array_equal(found.arrays[key], array)
    kept("b", 1000, make, ALL)
    assert times == [True, True] and held(cache_folder("grown")) > 1000


def rows_of(*tiles: tuple[int, int]) -> Tiles:
    out = np.zeros(ALL.shape, bool)
    for tile in tiles:
        out[tile] = True
    return out


def test_tiles_are_added_to_a_texture(tiny_bundle: Bundle):
    """Each once, also what is asked for with others; what is not asked for stays as it is. Nobody asks what is seen once all
    are there."""
    times: list[tuple[list, list]] = []

    def make(allocate: Allocate | None, tiles: Tiles, there: Tiles) -> Bundle:
        assert allocate is not None
        times.append((np.argwhere(tiles).tolist(), np.argwhere(there).tolist()))
        levels = {key: x for key, x in tiny_bundle.arrays.items() if key.startswith("features/")}
        new = allocate("features", [x.shape for x in levels.values()])
        new[0].reshape(-1)[: ALL.size] += len(times) * tiles.reshape(-1)
        return replace(tiny_bundle, arrays={**tiny_bundle.arrays, **dict(zip(levels, new, strict=True))})

    def added(*seen: tuple[int, int]) -> list:
        found = kept("a", 1000, make, ALL, lambda: rows_of(*seen))
        return found.arrays["features/0"].reshape(-1)[: ALL.size].tolist()

    assert added((0, 1), (1, 2)) == [0, 1, 0, 0, 0, 1]
    assert added((0, 1)) == [0, 1, 0, 0, 0, 1]
    assert added((0, 0), (0, 1)) == [2, 1, 0, 0, 0, 1]
    kept("a", 1000, make, ALL)
    assert times == [
        ([[0, 1], [1, 2]], []),
        ([[0, 0]], [[0, 1], [1, 2]]),
        ([[0, 2], [1, 0], [1, 1]], [[0, 0], [0, 1], [1, 2]]),
    ]
    kept("a", 1000, make, ALL, lambda: pytest.fail("asked for what is seen"))
    assert len(times) == 3


def test_tiles_that_a_killed_process_began_are_made_anew(maker):
    make, times = maker
    kept("a", 1000, make, ALL, lambda: rows_of((0, 0)))

    def killed(allocate: Allocate | None, tiles: Tiles, there: Tiles) -> Bundle:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept("a", 1000, killed, ALL)
    kept("a", 1000, make, ALL)
    (cache_folder("grown") / "a" / "tiles").unlink()
    kept("a", 1000, make, ALL)
    assert times == [True] * 3


def test_a_texture_that_cannot_be_added_to_is_made_in_memory(maker, monkeypatch: pytest.MonkeyPatch):
    make, times = maker
    kept("a", 1000, make, ALL, lambda: rows_of((0, 0)))
    (cache_folder("grown") / "a").chmod(0o555)

    def refused(*arguments: Any) -> None:
        raise InputError("tiles", "cannot be written")

    monkeypatch.setattr(kept_textures, "replace_file", refused)
    kept("a", 1000, make, ALL)
    assert times == [True, True, False]


def test_small_and_vast_ones_and_a_full_disk_are_not_kept(maker, monkeypatch: pytest.MonkeyPatch):
    make, times = maker
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 10)
    for size in (9, kept_textures.MAX_BYTES // 2 + 1):
        kept("a", size, make, ALL)
    monkeypatch.setattr(kept_textures.shutil, "disk_usage", lambda path: _Full)
    kept("a", 1000, make, ALL)
    assert times == [False, False, False] and not cache_folder("grown").exists()


class _Full:
    free = 2999


def test_what_is_damaged_is_made_anew(maker):
    make, times = maker
    kept("a", 1000, make, ALL)
    (cache_folder("grown") / "a" / "texture" / "features.npy").write_bytes(b"torn")
    found = kept("a", 1000, make, ALL)
    assert times == [True, True] and np.isfinite(found.arrays["features/0"]).all()
    kept("a", 1000, make, ALL)
    assert times == [True, True]


def test_a_cache_that_cannot_be_written_is_done_without(maker, tmp_path: Path):
    (tmp_path / "mesoshell").write_text("a file")
    make, times = maker
    kept("a", 1000, make, ALL)
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
    forget(tmp_path / "c", 15)
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def test_what_was_not_used_for_longest_goes(maker, monkeypatch: pytest.MonkeyPatch):
    make, _ = maker
    for age, key in enumerate("abc"):
        kept(key, 1000, make, ALL)
        os.utime(cache_folder("grown") / key, (1000.0 + age, 1000.0 + age))
    kept("a", 1000, make, ALL)  # used again: now the newest
    one = held(cache_folder("grown") / "a")
    monkeypatch.setattr(kept_textures, "MAX_BYTES", round(3.5 * one))
    kept("d", 1000, make, ALL)
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
