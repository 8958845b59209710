"""A texture with edges: of any size, clamped beyond them, the same as a wrapped one away from them."""

import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.texture import mip

TEXTURE = np.random.default_rng(0).normal(size=(24, 40, 3)).astype(np.float32)
LEVELS = mip.build_open(jnp.asarray(TEXTURE), 3)
SIZES = tuple((x.shape[0], x.shape[1]) for x in LEVELS)


def looked_up(u: float, v: float, level: float) -> np.ndarray:
    return np.asarray(mip.lookup(mip.pack(LEVELS), SIZES, jnp.array([u, v], jnp.float32), jnp.float32(level), 8.0))


def test_levels_are_means_and_an_odd_side_repeats_its_last_texel() -> None:
    assert SIZES == ((24, 40), (12, 20), (6, 10), (3, 5))
    np.testing.assert_allclose(LEVELS[3][1, 2], TEXTURE[8:16, 16:24].mean(axis=(0, 1)), rtol=0, atol=1e-6)
    odd = mip.build_open(jnp.asarray(TEXTURE[:3, :5]), 1)[1]
    np.testing.assert_allclose(odd[1, 2], TEXTURE[2, 4], rtol=1e-6)
    np.testing.assert_allclose(odd[0, 2], TEXTURE[:2, 4].mean(axis=0), rtol=1e-6)


@pytest.mark.parametrize(("i", "j", "level"), [(0, 0, 0), (23, 39, 0), (5, 17, 1), (2, 4, 3)])
def test_a_texels_middle_is_the_texel(i: int, j: int, level: int) -> None:
    i, j = min(i, SIZES[level][0] - 1), min(j, SIZES[level][1] - 1)
    side = 2.0**level / 8
    np.testing.assert_allclose(looked_up((j + 0.5) * side, (i + 0.5) * side, level), LEVELS[level][i, j], atol=1e-5)


def test_between_texels_and_levels_it_is_linear() -> None:
    found = looked_up(10 / 8, 7.5 / 8, 0.25)
    fine = (TEXTURE[7, 9] + TEXTURE[7, 10]) / 2
    a, b = LEVELS[1][3], LEVELS[1][4]  # at level 1, v = 3.25 + 0.5 texels and u = 4.5 + 0.5
    row = [0.75 * x + 0.25 * y for x, y in ((a[4], b[4]), (a[5], b[5]))]
    coarse = (row[0] + row[1]) / 2
    np.testing.assert_allclose(found, 0.75 * fine + 0.25 * coarse, atol=1e-5)


@pytest.mark.parametrize(("u", "v", "i", "j"), [(-3.0, -0.1, 0, 0), (99.0, 1.5 / 8, 1, 39), (0.5 / 8, 1e9, 23, 0)])
def test_beyond_the_edges_the_last_texel_goes_on(u: float, v: float, i: int, j: int) -> None:
    np.testing.assert_allclose(looked_up(u, v, 0), TEXTURE[i, j], atol=1e-5)
