"""Levels in one file: views where they lie in a row, copies where they do not. Oracle: concatenation."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.io.level_arrays import flatten, split

SHAPES = st.lists(st.lists(st.integers(0, 4), min_size=1, max_size=3).map(tuple), min_size=1, max_size=5)


@given(SHAPES, st.sampled_from([np.float16, np.float32]))
def test_what_was_split_is_one_array_again(shapes, dtype):
    levels = split(np.arange(sum(np.prod(s, dtype=int) for s in shapes)).astype(dtype), shapes)
    assert [x.shape for x in levels] == shapes
    found = flatten(levels)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.concatenate([x.ravel() for x in levels]))


def test_a_row_is_not_copied_and_anything_else_is():
    whole = np.arange(24, dtype=np.float16)
    first, second = split(whole, [(2, 2, 3), (3, 4)])
    assert np.shares_memory(flatten([first, second]), whole) and np.shares_memory(flatten([second]), whole)
    others = [second, first], [first, first], [first, second.copy()], [first.copy(), second], [first[:, :1], second]
    for levels in (*others, [first, second.T], [first, second.astype(np.float32)]):
        found = flatten(levels)
        assert not np.shares_memory(found, whole)
        np.testing.assert_array_equal(found, np.concatenate([x.ravel() for x in levels]))


def test_a_mapped_row_stays_mapped(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.arange(20, dtype=np.float16))
    mapped = np.load(tmp_path / "a.npy", mmap_mode="r")
    found = flatten(split(mapped, [(3, 4), (8,)]))
    assert np.shares_memory(found, mapped) and not found.flags.writeable


@pytest.mark.parametrize("shapes", [[(3,)], [(2, 2), (1,)], []])
def test_another_length_is_refused(shapes):
    with pytest.raises(ValueError):
        split(np.zeros(4), shapes)
