"""Fourier maps are exact far from the origin, the same for every tile, and move as they are told."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.signal import fourier
from mesoshell.signal.fourier import draw_drift, draw_frequencies

RATE = 64
fourier_map = jax.jit(fourier.fourier_map, static_argnums=(4, 5, 6, 7))
shifted_phase = jax.jit(fourier.shifted_phase)


DRIFT = 1.5


def exact(f: np.ndarray, slow: np.ndarray, phase: np.ndarray, i: int, j: int) -> np.ndarray:
    """Γ of one sinusoid a channel at sample (i, j) of the plane, in 60 digits."""
    with mpmath.workdps(60):
        x = [(mpmath.mpf(2 * k + 1) / (2 * RATE)) for k in (i, j)]
        n = len(slow)

        def one(c: int) -> float:
            turns = sum(x[axis] * int(f[c, axis]) for axis in (0, 1)) / 2**16 + mpmath.mpf(float(phase[0, c]))
            waves = [
                mpmath.sin(
                    2
                    * mpmath.pi
                    * (x[axis] * int(slow[s, axis]) / 2**16 + mpmath.mpf(float(phase[1 + axis * n + s, c])))
                )
                for axis in (0, 1)
                for s in range(n)
            ]
            return float(
                mpmath.sin(2 * mpmath.pi * turns + DRIFT * sum(waves) * mpmath.sqrt(mpmath.mpf(2) / max(n, 1)))
            )

        return np.array([one(c) for c in range(len(f))])


def drawn(seed: int, count: int, slow: int, batch: int = 1, low: float = 0.0, high: float = 8.0):
    """f, δ and φ."""
    rng = np.random.default_rng(seed)
    f, phase = draw_frequencies(rng, count, low, high), rng.uniform(size=(batch, 1 + 2 * slow, count))
    return jnp.asarray(f), jnp.asarray(draw_drift(rng, slow)), jnp.asarray(phase, jnp.float32)


@settings(max_examples=30, deadline=None)
@given(
    patch=st.integers(-4096, 4096),
    other=st.integers(-4096, 4096),
    offset=st.integers(0, 63),
    seed=st.integers(0, 99),
    slow=st.sampled_from([0, 4]),
)
def test_values_at_4096_patches(patch: int, other: int, offset: int, seed: int, slow: int) -> None:
    f, m, phase = drawn(seed, 8, slow, low=4.0, high=32.0)
    i, j = patch * RATE + offset, other * RATE - offset
    found = fourier_map(f, m, phase, jnp.array([i, j], jnp.int32), (2, 1), RATE, drift=DRIFT)
    for k in (0, 1):
        expected = exact(np.asarray(f), np.asarray(m), np.asarray(phase[0]), i + k, j)
        np.testing.assert_allclose(found[0, k, 0], expected, rtol=0, atol=4e-6 if slow else 2e-6)


def test_naive_arithmetic_would_fail_that() -> None:
    f, m, phase = drawn(0, 64, 0, low=4.0, high=32.0)
    i = 4096 * RATE + 17
    x = np.float32((i + 0.5) / RATE)
    cycles = (np.asarray(f, np.float32) * np.float32(2**-16)) @ np.array([x, x], np.float32) + np.asarray(phase[0, 0])
    naive = np.sin(np.float32(2 * np.pi) * cycles)
    assert np.abs(naive - exact(np.asarray(f), np.asarray(m), np.asarray(phase[0]), i, i)).max() > 0.05


@pytest.mark.parametrize("slow", [0, 5])
def test_tiles_are_parts_of_the_plane(slow: int) -> None:
    f, m, phase = drawn(1, 10, slow, batch=2)
    whole = fourier_map(f, m, phase, jnp.array([-20, 7], jnp.int32), (40, 30), RATE, 2, DRIFT)
    part = fourier_map(f, m, phase, jnp.array([-8, 19], jnp.int32), (9, 11), RATE, 2, DRIFT)
    assert whole.shape == (2, 40, 30, 5)
    np.testing.assert_allclose(part, whole[:, 12:21, 12:23], rtol=0, atol=2e-6)


@pytest.mark.parametrize("slow", [0, 5])
def test_shifted_phases_move_the_map(slow: int) -> None:
    f, m, phase = drawn(2, 6, slow, low=1.0)
    moved = shifted_phase(f, m, phase, jnp.array([3 / RATE, -5 / RATE], jnp.float32))
    start = jnp.array([0, 0], jnp.int32)
    a = fourier_map(f, m, moved, start, (16, 16), RATE, drift=DRIFT)
    b = fourier_map(f, m, phase, start + jnp.array([-3, 5], jnp.int32), (16, 16), RATE, drift=DRIFT)
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-5)


def test_power_is_a_half_whatever_it_is_made_of() -> None:
    for slow, waves in ((0, 1), (0, 4), (8, 1), (8, 4)):
        f, m, phase = drawn(5, 32 * waves, slow, low=1.0)
        power = jnp.mean(fourier_map(f, m, phase, jnp.zeros(2, jnp.int32), (512, 512), 32, waves, DRIFT) ** 2)
        np.testing.assert_allclose(power, 0.5, rtol=0.03)


def test_what_drifts_does_not_come_back() -> None:
    """A sinusoid without drift is in step with itself again at some lags beyond one patch; with it, at none of twelve."""
    rate, worst = 8, []
    for slow in (0, 8):
        f, m, phase = drawn(6, 4, slow, low=1.0, high=3.0)
        found = fourier_map(f, m, phase, jnp.zeros(2, jnp.int32), (40 * rate, 40 * rate), rate, drift=DRIFT)
        n, whole, peak = 28 * rate, np.asarray(found[0], np.float64), 0.0
        for lag in np.ndindex(24, 24):
            if max(lag) > 2:
                other = whole[lag[0] * rate // 2 :, lag[1] * rate // 2 :][:n, :n]
                peak = max(peak, np.abs((whole[:n, :n] * other).mean(axis=(0, 1))).max() / 0.5)
        worst.append(peak)
    assert worst[0] > 0.95 and worst[1] < 0.4, worst


@given(count=st.integers(0, 40), seed=st.integers(0, 99))
def test_slow_waves_lie_one_in_each_part_of_half_a_cycle(count: int, seed: int) -> None:
    slow = draw_drift(np.random.default_rng(seed), count)
    part = slow / 2**15 * count
    assert slow.shape == (count, 2) and (np.abs(part - np.arange(count)[:, None] - 0.5) <= 0.5 + count / 2**15).all()


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
    f, m, _ = drawn(4, 3, 2)
    start = jnp.array([5, -9], jnp.int32)
    with jax.enable_x64(True):
        phase = np.random.default_rng(4).uniform(size=(1, 5, 3))
        made = jax.jit(lambda p: fourier_map(f, m, p, start, (4, 4), RATE, drift=DRIFT).sum())
        found, step = np.asarray(jax.jit(jax.grad(made))(phase)), 1e-6
        for at in np.ndindex(phase.shape):
            apart = np.zeros(phase.shape)
            apart[at] = step
            there = float(made(phase + apart) - made(phase - apart)) / (2 * step)
            np.testing.assert_allclose(found[at], there, rtol=1e-6, atol=1e-7)
