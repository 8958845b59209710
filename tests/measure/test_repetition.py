"""Repeats are found where they are; noise and generated textures have none."""

import numpy as np
import pytest

from mesoshell.measure.repetition import autocorrelation, largest_repeat


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape)


def test_autocorrelation_is_the_sum_over_pairs() -> None:
    f = noise(5, 4, 2)
    x = f - f.mean(axis=(0, 1))
    found = autocorrelation(f)
    for v in (-3, 0, 2):
        for u in (0, 1, 3):
            a, b = (slice(0, 5 - v), slice(v, 5)) if v >= 0 else (slice(-v, 5), slice(0, 5 + v))
            pairs = np.mean(x[a, : 4 - u] * x[b, u:], axis=(0, 1)).sum()
            assert found[v + 4, u] == pytest.approx(pairs / np.mean(x**2, axis=(0, 1)).sum(), abs=1e-12)


def test_a_tiled_texture_repeats_and_noise_does_not() -> None:
    repeat, (v, u) = largest_repeat(np.tile(noise(16, 16, 3), (4, 5, 1)), 8)
    assert repeat == pytest.approx(1, abs=1e-9) and v % 16 == u % 16 == 0
    assert largest_repeat(noise(64, 80, 3), 8)[0] < 0.1
