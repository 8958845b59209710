"""PSNR and SSIM against values worked out by hand, and against the definition written as a sum over one window."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.measure.image import psnr, psnr_blocks, psnr_masked, ssim


def grey(value: float, side: int = 4) -> np.ndarray:
    return np.full((side, side, 3), value, np.float32)


def noise(seed: int, side: int = 16) -> np.ndarray:
    return np.random.default_rng(seed).random((side, side, 3), np.float32)


def ssim_of_one_window(a: np.ndarray, b: np.ndarray) -> float:
    """The definition on 11 × 11 pixels of one channel: every moment is a plain weighted sum."""
    weights = {(i, j): math.exp(-((i - 5) ** 2 + (j - 5) ** 2) / (2 * 1.5**2)) for i in range(11) for j in range(11)}
    total = sum(weights.values())
    mean_a = sum(w * float(a[at]) for at, w in weights.items()) / total
    mean_b = sum(w * float(b[at]) for at, w in weights.items()) / total
    var_a = sum(w * (float(a[at]) - mean_a) ** 2 for at, w in weights.items()) / total
    var_b = sum(w * (float(b[at]) - mean_b) ** 2 for at, w in weights.items()) / total
    cov = sum(w * (float(a[at]) - mean_a) * (float(b[at]) - mean_b) for at, w in weights.items()) / total
    c1, c2 = 0.0001, 0.0009
    return (2 * mean_a * mean_b + c1) * (2 * cov + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))


@pytest.mark.parametrize(
    ("b", "peak", "expected"), [(0.6, 1.0, 20.0), (0.51, 1.0, 40.0), (0.5, 1.0, math.inf), (0.6, 10.0, 40.0)]
)
def test_psnr_of_a_constant_error(b: float, peak: float, expected: float):
    assert psnr(grey(0.5), grey(b), peak) == pytest.approx(expected, abs=1e-4)


def test_psnr_of_one_wrong_pixel():
    wrong = grey(0.5)
    wrong[0, 0] = 0.75  # 1/16 of the pixels is wrong by 1/4: MSE = 2⁻⁸
    assert psnr(grey(0.5), wrong) == pytest.approx(24.0824, abs=1e-4)


def test_psnr_of_a_large_common_offset_keeps_the_difference():
    assert psnr(grey(1000), grey(1000.125)) == pytest.approx(18.0618, abs=1e-4)


def test_psnr_over_the_foreground_alone():
    a, b, mask = grey(0.5), grey(0.5), np.zeros((4, 4), bool)
    b[:2] = 0.6
    mask[1:3] = True  # half of the mask is wrong by 1/10
    assert psnr_masked(a, b, mask) == pytest.approx(23.0103, abs=1e-4)
    assert psnr_masked(a, b, ~mask, peak=10.0) == pytest.approx(43.0103, abs=1e-4)
    with pytest.raises(ValueError, match="PSNR over an empty mask"):
        psnr_masked(a, b, np.zeros((4, 4), bool))


def test_blocks_forgive_noise_and_keep_bias():
    board = np.indices((4, 4)).sum(axis=0)[..., None] % 2
    noisy = (0.25 + 0.5 * board * np.ones(3)).astype(np.float32)
    assert psnr(grey(0.5), noisy) == pytest.approx(12.0412, abs=1e-4)
    assert psnr_blocks(grey(0.5), noisy, 2) == math.inf
    assert psnr_blocks(grey(0.5), noisy + np.float32(0.1), 2) == pytest.approx(20, abs=1e-4)
    assert psnr_blocks(grey(0.5), noisy, 1) == psnr(grey(0.5), noisy)


@pytest.mark.parametrize("k", [3, 8])
def test_blocks_must_fit(k: int):
    with pytest.raises(ValueError, match=f"4 × 4 pixels are not whole blocks of {k} × {k}"):
        psnr_blocks(grey(0), grey(0), k)


@pytest.mark.parametrize("measure", [psnr, ssim])
def test_shapes_must_be_equal(measure):
    with pytest.raises(ValueError, match=r"images of different shapes: \(16, 16, 3\) and \(12, 12, 3\)"):
        measure(noise(0), noise(0, 12))


def test_ssim_of_constant_images():
    assert ssim(grey(0.5, 11), grey(0.75, 11)) == pytest.approx(0.7501 / 0.8126, abs=1e-9)
    assert ssim(grey(0, 11), grey(1, 11)) == pytest.approx(0.0001 / 1.0001, abs=1e-9)


def test_ssim_is_the_mean_of_the_definition_over_windows_and_channels():
    a, b = noise(1, 12), noise(2, 12)
    windows = [(slice(i, i + 11), slice(j, j + 11), c) for i in range(2) for j in range(2) for c in range(3)]
    expected = sum(ssim_of_one_window(a[at], b[at]) for at in windows) / len(windows)
    assert ssim(a, b) == pytest.approx(expected, abs=1e-12)


def test_ssim_of_a_grey_image_is_that_of_its_equal_channels():
    a, b = noise(1)[..., 0], noise(2)[..., 0]
    assert ssim(a, b) == pytest.approx(ssim(np.stack([a] * 3, axis=-1), np.stack([b] * 3, axis=-1)), abs=1e-12)


def test_ssim_needs_a_window():
    with pytest.raises(ValueError, match="SSIM needs 11 pixels a side, not 10 × 10"):
        ssim(noise(0, 10), noise(0, 10))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), scale=st.sampled_from((2.0, 255.0)))
def test_invariances(seed: int, scale: float):
    a, b = noise(seed), noise(seed + 1)
    assert ssim(a, a) == pytest.approx(1, abs=1e-12)
    assert ssim(a, b) == pytest.approx(ssim(b, a), abs=1e-12) and ssim(a, b) < 0.9
    assert ssim(a[::-1, ::-1], b[::-1, ::-1]) == pytest.approx(ssim(a, b), abs=1e-12)
    scaled_a, scaled_b = a.astype(np.float64) * scale, b.astype(np.float64) * scale
    assert ssim(scaled_a, scaled_b, peak=scale) == pytest.approx(ssim(a, b), abs=1e-9)
    assert psnr(scaled_a, scaled_b, peak=scale) == pytest.approx(psnr(a, b), abs=1e-9)
