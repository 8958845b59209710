"""Copies are found at any shift, by sums over windows as they are written."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mesoshell.measure.copies import among, layer_means, nearest


def exemplars(count: int, seed: int = 0) -> np.ndarray:
    x = np.random.default_rng(seed).normal(size=(count, 3, 24, 20))
    return gaussian_filter(x, (0, 0, 1, 1), mode="wrap")


def test_a_copy_is_found_where_it_was_cut() -> None:
    known = exemplars(4)
    window = np.roll(known[2], (-17, -9), axis=(1, 2))[:, :10, :12]
    found = nearest(window, known, layer_means(known))
    assert found.exemplar == 2 and found.shift == (17, 9) and found.distance == pytest.approx(0, abs=1e-12)


def test_every_shift_is_the_sum_over_its_window() -> None:
    known, mean = exemplars(1), layer_means(exemplars(1))
    x = exemplars(1, seed=1)[0][:, :9, :7]
    least = np.inf
    for v in range(24):
        for u in range(20):
            e = np.roll(known[0] - mean, (-v, -u), axis=(1, 2))[:, :9, :7]
            least = min(least, ((x - mean - e) ** 2).sum() / (((x - mean) ** 2).sum() + (e**2).sum()))
    assert nearest(x, known, mean).distance == pytest.approx(least, rel=1e-9)


def test_strangers_are_as_far_as_exemplars_from_each_other() -> None:
    known = exemplars(5)
    apart = [row.distance for row in among(known, (24, 20))]
    assert all(row.exemplar != i for i, row in enumerate(among(known, (24, 20))))
    stranger = nearest(exemplars(1, seed=9)[0], known, layer_means(known)).distance
    assert min(apart) * 0.9 < stranger < max(apart) * 1.1
    with pytest.raises(ValueError, match="two exemplars"):
        among(known[:1], (24, 20))
