"""Three planes a patch: what a lookup finds is the sum of three known functions, in the cell where it is asked."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.errors import InputError
from mesoshell.shell.generator.generator import init_averages, init_generator, synthesise_height
from mesoshell.shell.generator.model import generator_arrays, generator_fields, generator_model
from mesoshell.shell.generator.plan import GeneratorConfig, rows_of
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.triplane import PLANES, lookup_planes, pack_planes
from tests.helpers import growing

N, CELLS = 8, (2, 3)
SIZES = tuple((N >> i, N >> i) for i in range(4))
RNG = np.random.default_rng(0)
#: a plane's value at (x, y) is base + along · (x, y); one channel
BASE = RNG.normal(size=(*CELLS, PLANES))
ALONG = RNG.normal(size=(*CELLS, PLANES, 2))


@pytest.fixture(scope="module")
def pyramid():
    at = (np.arange(N) + 0.5) / N
    x, y = np.meshgrid(at, at)
    values = (
        BASE[..., None, None]
        + ALONG[..., 0, None, None] * x
        + ALONG[..., 1, None, None] * y  # (cells v, cells u, plane, y, x)
    )
    feature = values.transpose(0, 3, 1, 4, 2).reshape(CELLS[0] * N, CELLS[1] * N, PLANES)
    return pack_planes(jnp.asarray(feature, jnp.float32), SIZES)


LOOKUP = jax.jit(lambda pyramid, xi, r: lookup_planes(pyramid, SIZES, CELLS, xi, r, r))
inside = st.floats(0.5 / N, 1 - 0.5 / N, width=32)


@settings(deadline=None, max_examples=30)
@given(inside, inside, inside, st.integers(0, CELLS[0] - 1), st.integers(0, CELLS[1] - 1))
def test_a_lookup_is_the_sum_of_the_cells_planes(pyramid, u, v, h, row, column) -> None:
    xi = jnp.array([column + u, row + v, h], jnp.float32)
    zero = jnp.zeros(())
    found = LOOKUP(pyramid, xi, zero)
    expected = BASE[row, column].sum() + (ALONG[row, column] * [(u, v), (u, h), (v, h)]).sum()
    np.testing.assert_allclose(found, [expected], rtol=0, atol=2e-5)


@pytest.mark.parametrize("radius", [0.0, 1e-6, 0.3, 100.0, np.inf, np.nan])
def test_filters_reach_no_further_than_the_patch(pyramid, radius) -> None:
    """At any radius a lookup lies between a cell's own extremes, and its gradient is finite."""
    xi = jnp.array([1.999, 0.001, 0.5], jnp.float32)
    r = jnp.asarray(radius, jnp.float32)
    found, back = jax.vjp(lambda x: lookup_planes(pyramid, SIZES, CELLS, x, r, r), xi)
    reach = np.abs(ALONG[0, 1]).sum()
    assert BASE[0, 1].sum() - reach <= found[0] <= BASE[0, 1].sum() + reach
    assert jnp.isfinite(back(jnp.ones(1))[0]).all()


def test_coarsest_level_is_the_planes_mean(pyramid) -> None:
    wide = jnp.asarray(100.0)
    found = lookup_planes(pyramid, SIZES, CELLS, jnp.array([0.2, 1.7, 0.9]), wide, wide)
    np.testing.assert_allclose(found, [BASE[1, 0].sum() + ALONG[1, 0].sum() / 2], rtol=1e-5)


def test_the_generator_makes_all_three_and_no_height_feature() -> None:
    config = GeneratorConfig(16, "T", 64, 4, channels=4, layers=4, z=4, w=4, height_rows=8, planes=3)
    generator = init_generator(config, jax.random.key(0))
    assert rows_of(config)[-1].out_channels == 12 and generator.height == []
    assert not synthesise_height(config, generator, jnp.ones((2, 4))).any()


def test_no_texture_can_be_made_of_them() -> None:
    bundle = growing.bundle()
    config = replace(generator_model(bundle, "it").config, planes=3)
    made = generator_arrays(init_generator(config, jax.random.key(0)), init_averages(config))
    kept = {k: v for k, v in bundle.arrays.items() if not k.startswith("generator/")}
    planes = replace(bundle, arrays=kept | made, generator=generator_fields(config))
    with pytest.raises(InputError, match=r"^it: has three planes per patch, which end at its sides"):
        bake_bundle(planes, "it", (16, 16), TextureRequest())
