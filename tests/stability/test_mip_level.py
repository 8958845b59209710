"""Hard case 14: mip levels at any footprint, and filtered lookup in two dimensions and in one.

Oracle: a trilinear lookup in float64 NumPy, written from its definition: texel centres, wrap-around in (u, v), clamped in h.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.texture import mip

ROWS, COLUMNS, CHANNELS = 16, 32, 3
RNG = np.random.default_rng(5)
TEXTURE = RNG.normal(size=(ROWS, COLUMNS, CHANNELS)).astype(np.float32)
SIZES = mip.level_sizes(ROWS, COLUMNS)
LEVELS = mip.build(jnp.asarray(TEXTURE))
PYRAMID = mip.pack(LEVELS)
PROFILE = RNG.normal(size=(8, 1, CHANNELS)).astype(np.float32)
PROFILE_SIZES = mip.level_sizes(8, 1)
PROFILE_LEVELS = mip.build(jnp.asarray(PROFILE))
PROFILE_PYRAMID = mip.pack(PROFILE_LEVELS)
LAST = len(SIZES) - 1
lookup_many = jax.vmap(mip.lookup, in_axes=(None, None, 0, 0))
lookup_height_many = jax.vmap(mip.lookup_height, in_axes=(None, None, 0, 0))
level_of = jax.jit(jax.vmap(lambda r: mip.level_of(r, 256.0, LAST)))


def true_axis(x: float, n: int, wraps: bool) -> tuple[tuple[int, float], tuple[int, float]]:
    """The two texels around a coordinate in [0, 1], and their weights."""
    z = x * n - 0.5 if wraps else min(max(x * n - 0.5, 0.0), n - 1.0)
    i = int(np.floor(z))
    j = (i + 1) % n if wraps else min(i + 1, n - 1)
    return (i % n, 1 - (z - np.floor(z))), (j, z - np.floor(z))


def true_lookup(levels: list, uv: np.ndarray, level: float, wraps: bool = True) -> np.ndarray:
    """Trilinear value of box-averaged levels (H, W, C); uv in any range where it wraps."""
    lower = int(np.floor(level))
    total = np.zeros(CHANNELS)
    for l, share in ((lower, 1 - (level - lower)), (min(lower + 1, len(levels) - 1), level - lower)):
        h, w = levels[l].shape[:2]
        for y, fy in true_axis(uv[1], h, wraps):
            for x, fx in true_axis(uv[0], w, wraps):
                total += share * fx * fy * np.asarray(levels[l][y, x], np.float64)
    return total


def boxes(texture: np.ndarray) -> list:
    """Levels of a pyramid in float64 by direct means over ever larger boxes of the finest level."""
    levels = []
    for h, w in mip.level_sizes(*texture.shape[:2]):
        grid = texture.astype(np.float64).reshape(h, texture.shape[0] // h, w, texture.shape[1] // w, -1)
        levels.append(grid.mean(axis=(1, 3)))
    return levels


def test_odd_footprints_have_a_level():
    r = np.array([0, 1e-45, 1e-38, -1.0, np.nan, 1e-3, 1e30, 3e38, np.inf], np.float32)
    np.testing.assert_array_equal(level_of(r), [0, 0, 0, 0, 0, 0, LAST, LAST, LAST])
    odd = jnp.float32([-1.0, np.nan, -np.inf, 1e9, np.inf])
    found = lookup_many(PYRAMID, SIZES, jnp.zeros((5, 2)), odd)
    for value, level in zip(np.asarray(found), [0, 0, 0, LAST, LAST], strict=True):
        np.testing.assert_allclose(value, true_lookup(LEVELS, np.zeros(2), level), atol=1e-6)


@given(st.lists(st.floats(0, width=32), min_size=2, max_size=20))
def test_the_level_never_falls_as_the_footprint_grows(radii: list[float]):
    padded = np.sort(np.array(radii + [0.0] * (20 - len(radii)), np.float32))
    level = np.asarray(level_of(padded))
    assert (np.diff(level) >= 0).all()
    assert (level >= 0).all() and (level <= LAST).all()


def test_the_footprints_gradient_is_finite():
    slope = jax.vmap(jax.grad(lambda r: mip.level_of(r, 256.0, LAST)))
    assert np.isfinite(np.asarray(slope(jnp.float32([0, 1e-45, 1e-38, 1 / 512, 0.1, 1e30, np.inf])))).all()


def test_level_0_at_texel_centres_is_the_texture_itself():
    y, x = np.mgrid[:ROWS, :COLUMNS]
    uv = np.stack([(x + 0.5) / COLUMNS, (y + 0.5) / ROWS], axis=-1).reshape(-1, 2).astype(np.float32)
    for patches in (0, 7, -3):
        found = lookup_many(PYRAMID, SIZES, jnp.asarray(uv + np.float32(patches)), jnp.zeros(len(uv)))
        np.testing.assert_array_equal(found, TEXTURE.reshape(-1, CHANNELS))


def test_levels_are_box_averages():
    for found, true in zip(LEVELS, boxes(TEXTURE), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-6)


def test_lookup_is_trilinear_and_wraps():
    uv = RNG.uniform(-2, 3, (200, 2)).astype(np.float32)
    level = RNG.uniform(0, LAST, 200).astype(np.float32)
    level[:20] = np.arange(20) % (LAST + 1)
    uv[20:30] = [
        [0, 0],
        [1, 1],
        [0, 1],
        [1, 0],
        [-1, 2],
        [0.999999, 0],
        [0, 0.999999],
        [1e-7, 0],
        [0, 1e-7],
        [-1e-9, 0],
    ]
    found = lookup_many(PYRAMID, SIZES, jnp.asarray(uv), jnp.asarray(level))
    true = [true_lookup(boxes(TEXTURE), x.astype(np.float64), float(l)) for x, l in zip(uv, level, strict=True)]
    np.testing.assert_allclose(found, true, atol=1e-5)


def test_height_lookup_is_bilinear_and_clamped():
    h = np.concatenate([np.linspace(0, 1, 40), [-1, -1e-6, 1 + 1e-6, 2]]).astype(np.float32)
    last = len(PROFILE_SIZES) - 1
    level = RNG.uniform(0, last, len(h)).astype(np.float32)
    level[-4:] = 0
    found = lookup_height_many(PROFILE_PYRAMID, PROFILE_SIZES, jnp.asarray(h), jnp.asarray(level))
    pairs = zip(h.astype(float), level, strict=True)
    true = [true_lookup(boxes(PROFILE), np.array([0.5, x]), float(l), wraps=False) for x, l in pairs]
    np.testing.assert_allclose(found, true, atol=1e-5)
    np.testing.assert_array_equal(found[-4:], PROFILE[[0, 0, 7, 7], 0])


@pytest.mark.parametrize("level", [0.0, 1.3, float(LAST)])
def test_the_gradient_by_the_features_sums_to_one(level: float):
    def value(texture):
        return mip.lookup(mip.pack(mip.build(texture)), SIZES, jnp.float32([0.99, 0.01]), jnp.float32(level))[0]

    def height(profile):
        return mip.lookup_height(mip.pack(mip.build(profile)), PROFILE_SIZES, jnp.float32(0.98), jnp.float32(level))[0]

    pairs = ((value, TEXTURE), (height, PROFILE))
    for gradient in (jax.jit(jax.grad(f))(jnp.asarray(features)) for f, features in pairs):
        np.testing.assert_allclose(np.asarray(gradient).sum(axis=(0, 1)), [1, 0, 0], atol=1e-6)
        assert (np.asarray(gradient) >= 0).all()


def test_the_gradient_by_place_and_level_is_finite():
    for uv in ([0.0, 0.0], [0.5 / COLUMNS, 0.5 / ROWS], [1.0, 1.0], [4096.3, -4096.7]):
        for level in (0.0, 0.5, float(LAST)):
            by_uv, by_level = jax.grad(lambda x, l: mip.lookup(PYRAMID, SIZES, x, l).sum(), (0, 1))(
                jnp.float32(uv), jnp.float32(level)
            )
            assert np.isfinite(np.asarray(by_uv)).all() and np.isfinite(float(by_level))
