"""Sliced Wasserstein distances: closed forms, and what they must and must not see."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mesoshell.measure.sliced import COARSEST, PATCHES, SIDE, descriptors, pyramid, swd


def pictures(n: int, seed: int, blur: float = 1.5) -> np.ndarray:
    x = np.random.default_rng(seed).normal(size=(n, 32, 32, 3))
    return gaussian_filter(x, (0, blur, blur, 0)).astype(np.float32)


def test_a_pyramid_holds_the_picture() -> None:
    """A level is what enlarging the next one misses: a constant has nothing but its coarsest level."""
    fine, coarse = pyramid(np.full((2, 32, 32, 3), 0.3, np.float32))
    assert coarse.shape == (2, COARSEST, COARSEST, 3) and np.allclose(coarse, 0.3, atol=1e-6)
    assert np.abs(fine).max() < 1e-6


def test_a_shift_of_all_values_moves_every_direction_by_its_projection() -> None:
    """Of X and X + c the Wasserstein distance along a direction w is |c Σ w|; X has deviation 1 after normalising."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(40, PATCHES * 3 * SIDE**2)).astype(np.float32)
    x = (x - x.mean()) / x.std()
    w = np.random.default_rng(0).normal(size=(3 * SIDE**2, 128))
    expected = 0.5 * np.abs(w.sum(axis=0) / np.linalg.norm(w, axis=0)).mean()
    assert swd(x, x + np.float32(0.5)) == pytest.approx(expected, rel=0.01)
    assert swd(x, x) == 0


def test_sharpness_contrast_and_colour_are_seen_and_another_sample_is_not() -> None:
    real = descriptors(pictures(60, 0))
    floor = [swd(a, b) for a, b in zip(real, descriptors(pictures(60, 1)), strict=True)]
    worse = {
        "blurred": pictures(60, 1, blur=2.5),
        "dull": 0.5 * pictures(60, 1),
        "red": pictures(60, 1) + np.array([0.3, 0, 0], np.float32),
    }
    for name, x in worse.items():
        found = [swd(a, b) for a, b in zip(real, descriptors(x), strict=True)]
        assert max(f / g for f, g in zip(found, floor, strict=True)) > 3, name


def test_sets_of_other_sizes_are_refused() -> None:
    x = np.zeros((4, PATCHES * 3 * SIDE**2), np.float32)
    with pytest.raises(ValueError, match="4 and 3"):
        swd(x, x[:3])
