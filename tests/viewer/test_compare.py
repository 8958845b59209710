"""A wipe shows one picture left of its line and the other right of it; a map of errors is black where there are none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.measure.flip import flip
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.viewer.compare import difference, over_white, wipe


def picture(seed: int, height: int = 6, width: int = 9) -> np.ndarray:
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(0, 1, (height, width, 1))
    return np.concatenate([rng.uniform(0, 1, (height, width, 3)) * alpha, alpha], axis=-1)


@given(st.floats(0, 1))
def test_each_column_is_one_pictures_or_the_line(share: float):
    a, b = picture(1), picture(2)
    image, column = wipe(a, b, share), round(share * 9)
    np.testing.assert_array_equal(image[:, :column], over_white(a)[:, :column])
    right = slice(column + 1 if 0 < column < 9 else column, None)
    np.testing.assert_array_equal(image[:, right], over_white(b)[:, right])
    if 0 < column < 9:
        np.testing.assert_array_equal(image[:, column], 1)


def test_fewer_pixels_are_shown_with_as_many():
    coarse, fine = picture(1, 3, 4), picture(2, 6, 8)
    for image in (wipe(coarse, fine, 1.0), wipe(fine, coarse, 0.0)):
        assert image.shape == (6, 8, 3)
        mean = image.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(mean, over_white(coarse), atol=0.3)
        assert np.corrcoef(mean.ravel(), over_white(coarse).ravel())[0, 1] > 0.9
    even = np.full((3, 4, 4), 0.4)
    np.testing.assert_allclose(wipe(even, fine, 1.0), 1.0, atol=1e-6)


def test_a_map_of_errors_is_that_of_flip():
    a, b = picture(1, 20, 30), picture(2, 20, 30)
    same, other = difference(a, a), difference(a, b)
    assert same.flip == 0 and same.image.max() < 2e-3
    assert other.flip == pytest.approx(flip(over_backdrop(a), over_backdrop(b))) and other.image.max() > 0.1
    assert other.image.shape == (20, 30, 3)
