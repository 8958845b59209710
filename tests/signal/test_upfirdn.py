"""Resampling against SciPy's, its plain reference and its own derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.signal import upfirdn

from mesoshell.signal import upfirdn as resampling
from mesoshell.signal.upfirdn import Resampling
from tests.helpers.definitions import upfirdn_plain

resample = jax.jit(resampling.resample, static_argnums=(1, 2))


def scipys(x: np.ndarray, how: Resampling) -> np.ndarray:
    """One signal: SciPy's full convolution, from which the samples that padding a, b leaves are taken."""
    n = len(how.filter)
    first = n - 1 - how.pad[0]
    needed = first + how.down * how.outputs(len(x))
    full = upfirdn(how.filter, np.append(x, np.zeros(2 + abs(needed) // how.up + n)), how.up)
    full = np.concatenate([np.zeros(max(0, -first)), full[max(0, first) :]])
    return full[:: how.down][: how.outputs(len(x))]


cases = st.tuples(
    st.integers(1, 30),
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(-9, 14),
    st.integers(-9, 14),
    st.integers(1, 70),
)


@settings(max_examples=15, deadline=None)
@given(cases)
def test_is_scipys_for_any_factors_filter_and_padding(case: tuple[int, ...]) -> None:
    n, up, down, a, b, length = case
    assume(length * up + a + b >= n and a > -length * up and b > -length * up)
    rng = np.random.default_rng(n)
    x, how = rng.normal(size=length), Resampling(tuple(rng.normal(size=n)), up, down, (a, b))
    if b < 0:  # what is taken away at the end must not be seen by the last output
        assume(how.outputs(length) >= 1)
    with jax.enable_x64(True):
        y = resample(jnp.asarray(np.stack([x, -2 * x], axis=1)[None, :, None]), how, 1)
    np.testing.assert_allclose(y[0, :, 0, 0], scipys(x, how), rtol=0, atol=1e-12)
    np.testing.assert_allclose(y[0, :, 0, 1], -2 * scipys(x, how), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("up", "down", "taps"), [(2, 1, 12), (4, 1, 24), (1, 2, 12), (1, 4, 24), (1, 1, 1)])
@pytest.mark.parametrize("size", [(9, 30), (40, 11)])
def test_two_axes_are_the_plain_reference(up: int, down: int, taps: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    g = rng.normal(size=taps)
    pad = (7, 5) if up > 1 else (8, 7)
    how = Resampling(tuple(g), up, down, pad)
    with jax.enable_x64(True):
        x = jnp.asarray(rng.normal(size=(2, *size, 3)))
        plain = jax.jit(lambda x: upfirdn_plain(x, np.outer(g, g), up, down, [*pad, *pad]))(x)
        fast = resample(resample(x, how, 1), how, 2)
    np.testing.assert_allclose(fast, plain, rtol=0, atol=1e-11)


@pytest.mark.parametrize("axis", [1, 2])
def test_gradient_is_the_transposed_operation(axis: int) -> None:
    """⟨y, R x⟩ = ⟨Rᵀy, x⟩ for the derivative that JAX makes, since R is linear."""
    rng = np.random.default_rng(1)
    how = Resampling(tuple(rng.normal(size=12)), 2, 1, (3, 2))
    with jax.enable_x64(True):
        x = jnp.asarray(rng.normal(size=(1, 21, 19, 2)))
        y, transpose = jax.vjp(lambda x: resample(x, how, axis), x)
        other = jnp.asarray(rng.normal(size=y.shape))
        np.testing.assert_allclose(jnp.vdot(other, y), jnp.vdot(transpose(other)[0], x), rtol=1e-12)
