"""Hard case 10: extinction 0, 1e-30, 1e-12, 1e7 and infinity in the opacity.

Oracle: mpmath on the same floats, 50 digits; the derivatives are written out by hand. An infinite σ stands for its limit:
opacity 1 over any length above 0.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.numerics import opacity, optical_depth
from tests.helpers.stability.extremes import LENGTHS, SIGMAS, true_opacity


def alpha(sigma, t):
    return opacity(optical_depth(sigma, t))


@pytest.mark.parametrize("sigma", SIGMAS)
def test_value_and_both_derivatives(sigma: float):
    everything = jax.jit(lambda s, t: (alpha(s, t), *jax.grad(alpha, (0, 1))(s, t)))
    for t in LENGTHS:
        s32, t32 = jnp.float32(sigma), jnp.float32(t)
        value, by_sigma, by_t = (float(x) for x in everything(s32, t32))
        true = [float(x) for x in true_opacity(float(s32), float(t32))]
        np.testing.assert_allclose(value, true[0], rtol=1e-6, atol=1e-19)
        np.testing.assert_allclose(by_sigma, true[1], rtol=1e-6, atol=2e-7 * t)
        steepest = float(true_opacity(float(s32), 0.0)[2])  # JAX writes d expm1 as expm1 + 1: an absolute error of ε
        np.testing.assert_allclose(by_t, true[2], rtol=1e-6, atol=2e-7 * steepest + 1e-19)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_nothing_is_ever_nan(dtype: str):
    with jax.enable_x64(True):
        tiny = [0.0, 1e-45, 1e-38, 1e-30]
        sigma, t = np.meshgrid([*tiny, *SIGMAS, 1e20, 3e38], [*tiny, *LENGTHS, 1e10, 1e18])
        sigma, t = (jnp.asarray(x.ravel(), dtype) for x in (sigma, t))
        for x in (alpha(sigma, t), *jax.grad(lambda s, t: alpha(s, t).sum(), (0, 1))(sigma, t)):
            assert x.dtype == dtype
            assert np.isfinite(np.asarray(x)).all()


def test_an_infinite_extinction_over_no_length_is_empty():
    assert float(alpha(jnp.float32(np.inf), jnp.float32(0))) == 0
