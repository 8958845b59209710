"""Numbers of half precision that are read by fours, as integers, are the numbers."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.pathtracer import levels
from mesoshell.pathtracer.levels import Levels


def rows(table: Levels, count: int) -> np.ndarray:
    return np.stack([np.array(x) for x in table.row(dr.arange(mi.UInt32, count))], axis=1)


def test_every_finite_half_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """All 63 488 of them, subnormal ones and −0 among them, bit for bit."""
    every = np.arange(2**16, dtype=np.uint16).view(np.float16)
    every = every[np.isfinite(every)].reshape(1, -1, 8)
    plain = rows(Levels([every]), every.shape[1])
    monkeypatch.setattr(levels, "MAX_WIDENED", 0)
    found = rows(Levels([every]), every.shape[1])
    np.testing.assert_array_equal(found.view(np.uint32), every[0].astype(np.float32).view(np.uint32))
    np.testing.assert_array_equal(plain, found)


def test_rows_of_several_levels_in_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "MAX_WIDENED", 0)
    some = [np.random.default_rng(0).normal(size=(n, n, 12)).astype(np.float16) for n in (4, 2)]
    expected = np.concatenate([x.reshape(-1, 12) for x in some]).astype(np.float32)
    np.testing.assert_array_equal(rows(Levels(some), 20), expected)


@pytest.mark.parametrize(
    "array", [np.zeros((1, 4, 6), np.float16), np.zeros((1, 4, 8), np.float32), np.zeros((1, 5, 8), np.float16)]
)
def test_so_many_numbers_are_refused(array: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "MAX_WIDENED", 0)
    monkeypatch.setattr(levels, "MAX_ENTRIES", 10)
    with pytest.raises(InputError, match="too large for Mitsuba"):
        Levels([array])
