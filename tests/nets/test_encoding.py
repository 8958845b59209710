"""Encodings against what they are by hand, and hash grids against the laws of interpolation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.nets import encoding
from mesoshell.nets.encoding import HashConfig, frequency, init_tables

CONFIG = HashConfig(levels=4, features=2, rows=10, coarsest=4, finest=24)
POINT = st.tuples(*[st.floats(-1, 1, width=32)] * 3)
hashed = jax.jit(encoding.encode_hash_grid, static_argnums=0)


def tables() -> jax.Array:
    return jax.random.normal(jax.random.key(1), (4, 1024, 2))


def test_frequencies_by_hand() -> None:
    y = jnp.array([0.5, -0.25])
    wanted = [0.5, -0.25, 1.0, -np.sqrt(0.5), 0.0, -1.0, 0.0, np.sqrt(0.5), -1.0, 0.0]
    np.testing.assert_allclose(frequency(y, 2), wanted, atol=1e-6)


def test_levels_rise_geometrically_and_the_finest_are_hashed() -> None:
    assert CONFIG.resolutions == (4, 7, 13, 24)
    assert [(n + 1) ** 3 <= 1024 for n in CONFIG.resolutions] == [True, True, False, False]


@given(POINT)
def test_a_constant_table_is_a_constant(y) -> None:
    ones = jnp.ones((4, 1024, 2))
    np.testing.assert_allclose(hashed(CONFIG, ones, jnp.array(y, jnp.float32)), np.ones(8), rtol=1e-5)


@given(POINT, POINT)
def test_features_are_continuous(a, b) -> None:
    """No jump between cells: a step of 1e-4 moves a feature by less than its tables' spread times the cells stepped."""
    y = jnp.array(a, jnp.float32)
    near = jnp.clip(y + 1e-4 * jnp.array(b, jnp.float32), -1, 1)
    apart = jnp.abs(hashed(CONFIG, tables(), y) - hashed(CONFIG, tables(), near))
    spread = float(jnp.abs(tables()).max()) * 2
    assert float(apart.max()) <= 3 * spread * 1e-4 * 24 / 2 + 1e-5


def test_corners_have_their_rows() -> None:
    """By the paper's hash in Python's whole numbers, and by number where a level has no more corners than rows."""
    t = tables()
    for level, n in enumerate(CONFIG.resolutions):
        for i, j, k in ((0, 0, 0), (1, 2, 3), (n, n, n), (n - 1, 0, 2)):
            row = (i * (n + 1) + j) * (n + 1) + k
            if (n + 1) ** 3 > 1024:
                row = ((i * 1) ^ (j * 2654435761 & 0xFFFFFFFF) ^ (k * 805459861 & 0xFFFFFFFF)) & 1023
            found = hashed(CONFIG, t, jnp.array([i, j, k], jnp.float32) / n * 2 - 1)
            np.testing.assert_allclose(found[2 * level : 2 * level + 2], t[level, row], atol=2e-3)


@pytest.mark.parametrize("y", [(-3.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 5.0, -5.0)])
def test_points_outside_have_the_sides_features(y) -> None:
    inside = jnp.clip(jnp.array(y), -1, 1)
    np.testing.assert_array_equal(hashed(CONFIG, tables(), jnp.array(y)), hashed(CONFIG, tables(), inside))


def test_gradients_agree_with_differences() -> None:
    with jax.enable_x64(True):
        t = tables().astype(jnp.float64)
        y, d = jnp.array([0.313, -0.527, 0.111]), jnp.array([0.3, 0.5, -0.8])

        def f(t, y):
            return jnp.sum(jnp.sin(jnp.arange(8.0) + hashed(CONFIG, t, y)))

        slope = jax.grad(f, argnums=1)(t, y) @ d
        np.testing.assert_allclose(slope, (f(t, y + 1e-6 * d) - f(t, y - 1e-6 * d)) / 2e-6, rtol=1e-6)
        towards = jax.random.normal(jax.random.key(2), t.shape, jnp.float64)
        slope = jnp.vdot(jax.grad(f)(t, y), towards)
        np.testing.assert_allclose(slope, (f(t + 1e-6 * towards, y) - f(t - 1e-6 * towards, y)) / 2e-6, rtol=1e-6)


def test_tables_begin_small() -> None:
    t = init_tables(HashConfig(levels=2, rows=4), jax.random.key(0))
    assert t.shape == (2, 16, 2) and 5e-5 < float(jnp.abs(t).max()) <= 1e-4
