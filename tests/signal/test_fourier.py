"""Fourier maps are exact far from the origin, the same for every tile, and move as they are told."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.signal.fourier import draw_frequencies, fourier_map, shifted_phase

RATE = 64


def exact(f: np.ndarray, phase: np.ndarray, i: int, j: int) -> np.ndarray:
    """Γ at sample (i, j) of the plane, in 60 digits."""
    with mpmath.workdps(60):
        x = [(mpmath.mpf(2 * k + 1) / (2 * RATE)) for k in (i, j)]
        cycles = [
            (x[0] * int(a) + x[1] * int(b)) / 2**16 + mpmath.mpf(float(p)) for (a, b), p in zip(f, phase, strict=True)
        ]
        return np.array([float(mpmath.sin(2 * mpmath.pi * c)) for c in cycles])


@settings(max_examples=30, deadline=None)
@given(
    patch=st.integers(-4096, 4096), other=st.integers(-4096, 4096), offset=st.integers(0, 63), seed=st.integers(0, 99)
)
def test_values_at_4096_patches(patch: int, other: int, offset: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    f, phase = draw_frequencies(rng, 8, 4.0, 32.0), rng.uniform(size=8).astype(np.float32)
    i, j = patch * RATE + offset, other * RATE - offset
    start = jnp.array([i, j], jnp.int32)
    found = fourier_map(jnp.asarray(f), jnp.asarray(phase)[None], start, (2, 1), RATE)
    for k in (0, 1):
        np.testing.assert_allclose(found[0, k, 0], exact(f, phase, i + k, j), rtol=0, atol=2e-6)


def test_naive_arithmetic_would_fail_that() -> None:
    rng = np.random.default_rng(0)
    f, phase = draw_frequencies(rng, 64, 4.0, 32.0), rng.uniform(size=64).astype(np.float32)
    i = 4096 * RATE + 17
    x = np.float32((i + 0.5) / RATE)
    cycles = (f.astype(np.float32) * np.float32(2**-16)) @ np.array([x, x], np.float32) + phase
    naive = np.sin(np.float32(2 * np.pi) * cycles)
    assert np.abs(naive - exact(f, phase, i, i)).max() > 0.05


def test_tiles_are_parts_of_the_plane() -> None:
    rng = np.random.default_rng(1)
    f, phase = jnp.asarray(draw_frequencies(rng, 5, 0.0, 8.0)), jnp.asarray(rng.uniform(size=(2, 5)), jnp.float32)
    whole = fourier_map(f, phase, jnp.array([-20, 7], jnp.int32), (40, 30), RATE)
    part = fourier_map(f, phase, jnp.array([-8, 19], jnp.int32), (9, 11), RATE)
    np.testing.assert_array_equal(part, whole[:, 12:21, 12:23])


def test_shifted_phases_move_the_map() -> None:
    rng = np.random.default_rng(2)
    f, phase = jnp.asarray(draw_frequencies(rng, 6, 1.0, 8.0)), jnp.asarray(rng.uniform(size=(1, 6)), jnp.float32)
    moved = shifted_phase(f, phase, jnp.array([3 / RATE, -5 / RATE], jnp.float32))
    start = jnp.array([0, 0], jnp.int32)
    a = fourier_map(f, moved, start, (16, 16), RATE)
    b = fourier_map(f, phase, start + jnp.array([-3, 5], jnp.int32), (16, 16), RATE)
    np.testing.assert_allclose(a, b, rtol=0, atol=5e-6)


@pytest.mark.parametrize(("low", "high"), [(0.0, 2.0), (4.0, 5.0)])
def test_frequencies_fill_their_annulus_evenly(low: float, high: float) -> None:
    f = draw_frequencies(np.random.default_rng(3), 20_000, low, high) / 2**16
    radius = np.hypot(*f.T)
    assert radius.min() >= low - 1e-4 and radius.max() < high + 1e-4
    area = (radius**2 - low**2) / (high**2 - low**2)  # uniform in [0, 1] if the density a unit area is constant
    counts = np.histogram(area, 10, (0, 1))[0]
    assert np.abs(counts - 2000).max() < 6 * 2000**0.5
    turns = np.histogram(np.arctan2(*f.T), 12, (-np.pi, np.pi))[0]
    assert np.abs(turns - 20_000 / 12).max() < 6 * (20_000 / 12) ** 0.5


def test_gradient_with_respect_to_phases_is_the_derivative() -> None:
    rng = np.random.default_rng(4)
    f = jnp.asarray(draw_frequencies(rng, 3, 0.0, 8.0))
    start = jnp.array([5, -9], jnp.int32)
    with jax.enable_x64(True):
        phase = jnp.asarray(rng.uniform(size=(1, 3)))
        found = jax.grad(lambda p: fourier_map(f, p, start, (4, 4), RATE).sum())(phase)
        quarter = fourier_map(f, phase + 0.25, start, (4, 4), RATE)
        np.testing.assert_allclose(found[0], 2 * np.pi * quarter[0].sum(axis=(0, 1)), rtol=1e-6)
