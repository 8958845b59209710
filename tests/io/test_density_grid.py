"""What a grid of density is, and when it is made."""

import numpy as np
import pytest

from mesoshell.io import density_grid
from mesoshell.io.density_grid import K, grid_shape, in_half, kept_grid

MOST = 2**25


def test_a_texel_has_two_columns_where_there_is_room():
    assert grid_shape((256, 256, 32), 1, MOST) == (2, 512, 512, K)
    assert grid_shape((512, 512, 32), 0, MOST) == (512, 512, K)
    assert grid_shape((4096, 2, 32), 3, 1) == (2, 2, 2, 4096, 2, K)  # too many: who asks has to look


def test_what_half_precision_cannot_hold_is_its_largest():
    np.testing.assert_array_equal(
        in_half(np.array([0, 0.5, 1e9, np.inf])), np.array([0, 0.5, 65504, 65504], np.float16)
    )


def test_a_grid_is_made_once(monkeypatch: pytest.MonkeyPatch, tmp_path):
    """For what it is of, and its shape; a small one is not kept, and a damaged one is made anew."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []

    def make() -> np.ndarray:
        made.append(len(made))
        return np.full(6, made[-1], np.float16)

    def first_number(*of: object, shape: tuple[int, ...] = (1, 2, 3)) -> float:
        return float(kept_grid(of, shape, make)[0])

    assert [first_number("a"), first_number("a")] == [0, 1]  # as small ones are
    monkeypatch.setattr(density_grid, "MIN_KEPT", 6)
    assert [first_number("a"), first_number("a"), first_number("b"), first_number("a", shape=(6,))] == [2, 2, 3, 4]
    assert first_number("a") == 2
    for entry in (tmp_path / "mesoshell" / "densities").iterdir():
        entry.write_bytes(entry.read_bytes()[:-40])
    assert first_number("a") == 5 and first_number("a") == 5
