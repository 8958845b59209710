"""A cone's Gaussian on the texture: against eigenvalues of the projected covariance in float64."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.texture.footprint import footprint


def true_covariance(inverse: np.ndarray, d: np.ndarray, along: float, across: float) -> np.ndarray:
    outer = np.outer(d, d)
    return inverse @ (along * outer + across * (np.eye(3) - outer)) @ inverse.T


@pytest.mark.parametrize("seed", range(8))
def test_the_ellipse_is_the_projected_gaussian(seed: int):
    random = np.random.default_rng(seed)
    inverse = random.normal(size=(3, 3)).astype(np.float32)
    d = random.normal(size=3)
    d = (d / np.linalg.norm(d)).astype(np.float32)
    along, across = (float(x) for x in 10.0 ** random.uniform(-4, 1, 2))
    f = footprint(jnp.asarray(inverse), jnp.asarray(d), jnp.float32(along), jnp.float32(across))
    covariance = true_covariance(inverse.astype(float), d.astype(float), along, across)
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    np.testing.assert_allclose([f.minor, f.major], np.sqrt(values), rtol=2e-3)
    np.testing.assert_allclose(abs(vectors[:, 1] @ np.asarray(f.axis)), 1, atol=1e-4)
    np.testing.assert_allclose(f.height, abs(inverse[2] @ d) * np.sqrt(along), rtol=1e-4)


@given(st.lists(st.floats(-10, 10, width=32), min_size=12, max_size=12), st.floats(0, 1e4), st.floats(0, 1e4))
@settings(max_examples=50)
def test_any_ellipse_is_finite_and_ordered(numbers, along: float, across: float):
    d = np.array(numbers[9:])
    d = d / max(np.linalg.norm(d), 1e-6)
    inverse = jnp.float32(numbers[:9]).reshape(3, 3)
    f = footprint(inverse, jnp.asarray(d, jnp.float32), jnp.float32(along), jnp.float32(across))
    assert all(np.isfinite(np.asarray(x)).all() for x in f)
    assert 0 <= float(f.minor) <= float(f.major) * (1 + 1e-6)


def test_a_round_gaussian_seen_from_above_is_round():
    f = footprint(jnp.eye(3), jnp.float32([0, 0, -1]), jnp.float32(9.0), jnp.float32(4.0))
    np.testing.assert_allclose([f.minor, f.major, f.height], [2, 2, 3], rtol=1e-6)


def test_what_lies_across_a_ray_does_not_blur_the_height():
    """Its neighbours in the cone come through the same heights: only along the ray is a sample's height uncertain."""
    d = jnp.float32([0.8, 0, -0.6])
    narrow, wide = (footprint(jnp.eye(3), d, jnp.float32(0.01), jnp.float32(across)) for across in (1e-6, 4.0))
    np.testing.assert_allclose([narrow.height, wide.height], 0.06, rtol=1e-5)
    level = footprint(jnp.eye(3), jnp.float32([1, 0, 0]), jnp.float32(0.01), jnp.float32(4.0))
    assert float(level.height) == 0
