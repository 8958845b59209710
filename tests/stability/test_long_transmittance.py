"""Hard case 11: transmittance over thousands of steps, by summed optical depth.

Oracle: mpmath sums of the same float32 depths; log T is compared, since T itself leaves the range of floats.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.render.composite import weights
from mesoshell.shell.render.renderer import accumulate, draw
from tests.helpers.stability.extremes import STEPS, depths, true_sums


@pytest.mark.parametrize("total", [1e-6, 1.0, 60.0])
def test_log_transmittance_of_one_ray(total: float):
    tau = depths(total, 1)
    w, through = jax.jit(weights)(jnp.asarray(tau))
    sums = true_sums(tau)
    np.testing.assert_allclose(
        np.log(np.float64(through)), -sums[-1], rtol=1e-6, atol=1.2e-7
    )  # T near 1 is rounded to ε
    np.testing.assert_allclose(np.asarray(w), np.exp(-sums[:-1]) * -np.expm1(-np.float64(tau)), rtol=2e-5, atol=1e-30)
    np.testing.assert_allclose(np.asarray(w, np.float64).sum() + through, 1, atol=1e-6)


def test_the_gradient_is_finite_and_right():
    tau = depths(60.0, 2)
    gradient = jax.jit(jax.grad(lambda x: jnp.log(weights(x)[1])))(jnp.asarray(tau))
    np.testing.assert_allclose(np.asarray(gradient), -1, rtol=1e-6)
    far = jax.grad(lambda x: jnp.sum(weights(x)[0] * jnp.arange(3.0)) + weights(x)[1])
    assert np.isfinite(np.asarray(far(jnp.float32([1e4, 1e20, 0.0])))).all()


def test_many_rays_in_waves_beyond_the_range_of_floats():
    """Ray 0 is opaque at once, rays 1 to 3 reach T = e⁻³⁰⁰, e⁻¹ and 1: what ray 0 meets must not cost the others a digit."""
    taus = [np.full(STEPS, 1e19, np.float32), depths(300.0, 3), depths(1.0, 4), np.zeros(STEPS, np.float32)]
    depth, found = np.zeros(4), []
    for wave in np.split(np.arange(STEPS), STEPS // 8):
        w, _, depth = accumulate(depth, np.repeat(np.arange(4), 8), np.concatenate([x[wave] for x in taus]))
        found.append(w.reshape(4, 8))
    found = np.concatenate(found, axis=1)
    for ray in (1, 2, 3):
        sums = true_sums(taus[ray])
        np.testing.assert_allclose(depth[ray], sums[-1], rtol=1e-12)
        np.testing.assert_allclose(found[ray], np.exp(-sums[:-1]) * -np.expm1(-np.float64(taus[ray])), rtol=1e-6)
    np.testing.assert_array_equal(found[0], np.eye(1, STEPS)[0])


def test_a_ray_without_samples_stays_clear():
    _, _, depth = accumulate(np.array([0.5, 0.25]), np.array([1, 1]), np.array([1.0, 2.0], np.float32))
    np.testing.assert_array_equal(depth, [0.5, 3.25])


@given(
    depths_of=st.lists(st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 1.0, 30.0, 1e19]), min_size=1, max_size=40),
    count=st.integers(1, 8),
    u=st.floats(0.0, 1.0, exclude_max=True),
)
def test_drawn_samples_share_the_rays_opacity(depths_of: list[float], count: int, u: float):
    """As many as there are levels below the ray's opacity; each sample as many times as its weight is worth, to one."""
    tau = np.array(depths_of, np.float32)
    weight, before, _ = accumulate(np.zeros(1), np.zeros(len(tau), np.int64), tau)
    drawn = draw(before, tau, np.full(len(tau), u), count) * count
    np.testing.assert_array_equal(drawn, np.round(drawn))
    assert (drawn >= 0).all() and (np.abs(drawn - count * weight) <= 1).all()
    levels = (np.arange(count) + u) / count
    opacity = -np.expm1(-np.float64(tau).sum())
    assert abs(drawn.sum() - (levels < opacity).sum()) <= (np.abs(levels - opacity) < 1e-7).any()


def test_in_the_mean_a_drawn_sample_weighs_what_it_is():
    tau = np.concatenate([depths(0.7, 5), depths(3.0, 6)]).astype(np.float32)
    owner = np.repeat(np.arange(2), STEPS)
    weight, before, _ = accumulate(np.zeros(2), owner, tau)
    u = (np.arange(2_000) + 0.5) / 2_000
    for count in (1, 3):
        mean = np.mean([draw(before, tau, np.full(len(tau), x), count) for x in u], axis=0)
        np.testing.assert_allclose(mean, weight, atol=1 / (len(u) * count) * 2)
