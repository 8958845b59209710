"""Where samples lie: places by what a ray is expected to lose, and how they fall on its intervals.

Oracles: the inverse of the same distribution in float64; integrals of functions that are known; the renderer with many samples,
spread by length.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.render.quality import WIDEST
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.spacing import BINS, Placed, expected_places, on_intervals
from tests.helpers import scenes

DEPTHS = st.lists(st.one_of(st.just(0.0), st.floats(2.0**-60, 2.0**40, width=32)), min_size=BINS, max_size=BINS).map(
    lambda x: np.array(x, np.float32)
)

#: Few numbers of samples: each is a program of its own.
COUNTS = st.sampled_from([1, 2, 3, 7, 24, 40])
compiled_places = jax.jit(expected_places, static_argnums=0)


def placed(depth: np.ndarray, samples: int, shift: float) -> Placed:
    return Placed(*(np.asarray(x) for x in compiled_places(samples, jnp.asarray(depth), jnp.float32(shift))))


@given(DEPTHS, COUNTS, st.sampled_from([0.0, 0.5, 0.96875]))
@settings(max_examples=100)
def test_samples_lie_in_order_and_none_stands_for_much(depth: np.ndarray, samples: int, shift: float):
    p = placed(depth, samples, shift)
    assert (p.x >= 0).all() and (p.x <= 1).all() and (np.diff(p.x) >= -1e-6).all()
    assert (p.share > 0).all() and p.share.max() <= 1.01 * WIDEST / samples


@pytest.mark.parametrize("depth", [0.0, 1e-3])
def test_where_nothing_is_known_samples_are_even(depth: float):
    """Of e → 0 all bins are alike: as many samples in each."""
    p = placed(np.full(BINS, depth, np.float32), 8, 0.5)
    np.testing.assert_allclose(p.x, (np.arange(8) + 0.5) / 8, atol=0.02)
    np.testing.assert_allclose(p.share, 1 / 8, rtol=0.1)


@given(DEPTHS, COUNTS)
@settings(max_examples=50)
def test_places_are_those_of_float64(depth: np.ndarray, samples: int):
    b = depth.astype(np.float64)
    e = 0.025 * b
    parts = np.exp(e - np.cumsum(e)) * -np.expm1(-e), -np.expm1(-BINS * b)
    lost, occupied = (x / x.sum() if x.sum() > 0 else x for x in parts)
    p = 0.5 * lost + 0.4 * occupied + 0.1 / BINS
    through = np.concatenate([[0], np.cumsum(p / p.sum())])
    x = np.interp((np.arange(samples) + 0.5) / samples, through, np.linspace(0, 1, BINS + 1))
    np.testing.assert_allclose(placed(depth, samples, 0.5).x, x, atol=2e-5)


def test_half_of_the_samples_lie_where_light_is_lost():
    """A wall in the middle of thin air."""
    depth = np.full(BINS, 1e-3, np.float32)
    depth[BINS // 2] = 1e3
    x = placed(depth, 40, 0.5).x * BINS
    assert 20 <= ((x >= BINS // 2) & (x < BINS // 2 + 1)).sum() <= 32


@given(DEPTHS)
@settings(max_examples=50)
def test_every_bin_counts_as_it_is_long(depth: np.ndarray):
    """Over 512 evenly spaced shifts the shares of the samples in a bin add up to its own, to two of them."""
    shifts = jnp.asarray((np.arange(512) + 0.5) / 512, jnp.float32)
    x, share = jax.vmap(lambda shift: compiled_places(6, jnp.asarray(depth), shift))(shifts)
    k = np.minimum((np.asarray(x) * BINS).astype(int), BINS - 1).ravel()
    total = np.bincount(k, np.asarray(share, np.float64).ravel(), BINS) / 512
    largest = np.zeros(BINS)
    np.maximum.at(largest, k, np.asarray(share).ravel())
    assert (np.abs(total - 1 / BINS) <= 2.1 * largest / 512 + 1e-5).all()


def test_a_sample_lies_on_the_interval_that_its_place_falls_on():
    """Two rays; one has an interval of no length, which gets no sample."""
    length = np.array([1.0, 0.0, 3.0, 0.5], np.float32)
    x = np.array([[0.0, 0.25, 0.625, 1.0], [0.0, 0.5, 0.75, 1.0]], np.float32)
    p = Placed(x, np.full((2, 4), 0.25, np.float32))
    s = on_intervals(p, length, np.array([0, 3]))
    np.testing.assert_array_equal(s.row, [0, 2, 2, 2, 3, 3, 3, 3])
    np.testing.assert_allclose(s.f, [0, 0, 0.5, 1, 0, 0.5, 0.75, 1])
    np.testing.assert_allclose(s.step, [1] * 4 + [0.125] * 4)
    np.testing.assert_allclose(s.share, [1, 1 / 3, 1 / 3, 1 / 3] + [0.25] * 4, rtol=1e-6)


def test_rays_without_length_or_intervals_are_no_fault():
    none = Placed(*(np.zeros((0, 4), np.float32),) * 2)
    assert not len(on_intervals(none, np.zeros(0, np.float32), np.zeros(0, int)).row)
    flat = Placed(np.array([[0.1, 0.9]], np.float32), np.array([[0.5, 0.5]], np.float32))
    s = on_intervals(flat, np.zeros(2, np.float32), np.array([0]))
    assert np.isfinite(s.f).all() and (s.step == 0).all() and (s.row <= 1).all()


def test_many_samples_by_density_are_many_by_length(tiny_bundle):
    """Both tend to the same picture; `skip` is of samples by length."""
    scene = scenes.slab(tiny_bundle)
    many = scenes.FULL.with_changes(samples=512, skip=0.9)
    by_length, by_density = (
        render(scene, q, scenes.effects(scene, q))[0]
        for q in (many.with_changes(skip=0.0), many.with_changes(spacing="density"))
    )
    np.testing.assert_allclose(by_density, by_length, atol=2e-3 * by_length.max())


def test_blades_after_free_space_need_fewer_samples():
    """Blades a four hundredth of a ray wide cross a fifth of it, the rest is free. Where its light comes from, against the sum
    over 16 384 pieces: of 20 rays and 32 shifts, 12 samples err less than 24 spread evenly."""
    x, shifts = (np.arange(16384) + 0.5) / 16384, (np.arange(32) + 0.5) / 32
    bins = np.minimum((x * BINS).astype(int), BINS - 1)
    errors = np.zeros(2)
    for seed in range(20):
        random = np.random.default_rng(seed)
        free = random.uniform(0, 0.8)
        blades = np.repeat(random.random(400) < 0.3, 41)[:16384] & (x > free) & (x < free + 0.2)

        def light(at: np.ndarray, share: np.ndarray | float, sigma: np.ndarray = 400.0 * blades) -> float:
            tau = sigma[np.minimum((at * 16384).astype(int), 16383)] * share
            return float((np.exp(tau - np.cumsum(tau)) * -np.expm1(-tau) * at).sum())

        depth = ((np.bincount(bins, blades, BINS) > 0) * 400.0 / BINS).astype(np.float32)
        true = light(x, 1 / 16384)
        errors[0] += sum((light(p.x, p.share) - true) ** 2 for p in (placed(depth, 12, s) for s in shifts))
        errors[1] += sum((light((np.arange(24) + s) / 24, 1 / 24) - true) ** 2 for s in shifts)
    assert errors[0] < errors[1]
