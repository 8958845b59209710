"""Hard case 12: softplus and exponentials at ±1e4, values and gradients, alone and as the decoder's σ and ρ.

Oracle: log1p(eˣ) and 1/(1 + e⁻ˣ) in mpmath.
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

from mesoshell.nets.mlp import Dense
from mesoshell.numerics import opacity, softplus
from mesoshell.shell.material.decoder import Decoder, head, toward_viewer, trunk
from tests.helpers.stability.extremes import POINTS, true_softplus


def true_slope(x: np.ndarray) -> np.ndarray:
    return np.array([float(1 / (1 + mpmath.exp(-mpmath.mpf(float(v))))) for v in x])


def constant(raw_sigma: float, raw_rho: float) -> Decoder:
    """A decoder whose outputs are these numbers before their softplus, whatever it sees."""
    hidden = [Dense(jnp.ones((1, 2)), jnp.zeros(2))]
    seen = [Dense(jnp.ones((8, 2)), jnp.zeros(2))]
    return Decoder(
        trunk=hidden,
        sigma=Dense(jnp.zeros((2, 1)), jnp.full(1, raw_sigma)),
        head=seen,
        rho=Dense(jnp.zeros((2, 3)), jnp.full(3, raw_rho)),
        scale=jnp.asarray(30.0),
    )


def test_softplus():
    x = jnp.asarray(POINTS)
    np.testing.assert_allclose(np.asarray(softplus(x)), true_softplus(POINTS), rtol=1e-6, atol=1e-37)
    slope = jax.vmap(jax.grad(softplus))(x)
    np.testing.assert_allclose(np.asarray(slope), true_slope(POINTS), rtol=1e-6, atol=1e-37)


def test_opacity_at_great_depth():
    value, slope = jax.value_and_grad(opacity)(jnp.float32(1e4))
    assert (float(value), float(slope)) == (1.0, 0.0)


def test_extinction_and_its_gradient_through_the_trunk():
    for raw in POINTS:
        run = jax.value_and_grad(lambda d: trunk(d, jnp.ones(1))[0])
        sigma, gradient = run(constant(float(raw), 0.0))
        shifted = np.array([raw - np.float32(3)])
        np.testing.assert_allclose(float(sigma), 30 * true_softplus(shifted)[0], rtol=1e-6, atol=1e-36)
        np.testing.assert_allclose(float(gradient.sigma.bias[0]), 30 * true_slope(shifted)[0], rtol=1e-6, atol=1e-36)
        assert all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves(gradient))


def test_transport_and_its_gradient_through_the_head():
    up = jnp.float32([0, 0, 1])
    for raw in POINTS:
        run = jax.value_and_grad(lambda d: head(d, toward_viewer(d, jnp.ones(2), up), up)[0])
        rho, gradient = run(constant(0.0, float(raw)))
        shifted = np.array([raw - np.float32(2)])
        np.testing.assert_allclose(float(rho), true_softplus(shifted)[0], rtol=1e-6, atol=1e-37)
        assert all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves(gradient))


def test_directions_straight_down_or_zero_have_finite_gradients():
    decoder = constant(0.0, 0.0)
    for w in ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, -1e-30]):
        run = jax.grad(lambda a, b: head(decoder, toward_viewer(decoder, jnp.ones(2), a), b).sum(), (0, 1))
        assert all(np.isfinite(np.asarray(g)).all() for g in run(jnp.float32(w), jnp.float32(w)))
