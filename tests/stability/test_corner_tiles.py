"""Hard cases 9, 13, 14 and 20 on a plane of corner tiles: borders, places far out, odd footprints, a white furnace.

Oracle: the values of the same texture without tiles, where tiles must not matter; finite numbers, where only that is asked.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.bundle import Bundle
from mesoshell.shell.material.field import Point, neural_field
from mesoshell.shell.material.loader import load_device_material

#: Borders and corners of patches, from both sides, here and at 4096 patches, and what has no more digits than whole patches.
PLACES = [
    [0.0, 0.0],
    [-0.0, 1e-45],
    [np.nextafter(np.float32(1), np.float32(0)), 1.0],
    [-1e-9, 0.5],
    [4096.0, -4096.0],
    [np.nextafter(np.float32(4096), np.float32(0)), -4095.5],
    [2.0**24, -(2.0**24)],
    [2.0**31, 1e20],
]
RADII = [0.0, 1e-45, 1e-3, 0.5, 4.0, 1e30, np.inf, np.nan]


def density(bundle: Bundle):
    made = load_device_material(bundle)
    field = neural_field(made.material, made.layout)

    def at(uv, h, radius):
        return field.density(Point(jnp.append(uv, h), radius, jnp.float32(0), jnp.float32([0.3])))[0]

    return jax.jit(jax.vmap(jax.value_and_grad(at, (0, 1)), in_axes=(0, None, 0)))


def test_density_and_its_slope_are_finite_anywhere(tiled_bundle: Bundle) -> None:
    uv = jnp.repeat(jnp.float32(PLACES), len(RADII), axis=0)
    radii = jnp.tile(jnp.float32(RADII), len(PLACES))
    sigma, slopes = density(tiled_bundle)(uv, jnp.float32(0.5), radii)
    assert np.isfinite(sigma).all() and (np.asarray(sigma) >= 0).all()
    assert all(np.isfinite(slope).all() for slope in slopes)


def test_the_least_step_over_a_border_changes_nothing(tiled_bundle: Bundle) -> None:
    random = np.random.default_rng(0)
    border = random.integers(-4096, 4096, 300).astype(np.float32)
    along = random.uniform(-4096, 4096, 300).astype(np.float32)
    look, radius = density(tiled_bundle), jnp.asarray(np.exp(random.uniform(-6, 1, 300)), jnp.float32)
    for turn in (1, -1):
        sides = [np.stack([u, along][::turn], axis=1) for u in (border, np.nextafter(border, np.float32(np.inf)))]
        before, after = (np.asarray(look(jnp.asarray(uv), jnp.float32(0.4), radius)[0]) for uv in sides)
        assert before.std() > 1
        # a step of 2^-12 patches at most, of a σ that changes by its own size within a texel, a quarter of a patch
        np.testing.assert_allclose(after, before, rtol=0.02, atol=0.02 * before.mean())


@pytest.mark.parametrize("radius", [0.0, 0.1, 8.0])
def test_equal_tiles_are_the_patch_itself(tiny_bundle: Bundle, tiled_bundle: Bundle, radius: float) -> None:
    """Sixteen tiles that are all one patch: what that patch gives alone, wherever one looks."""
    arrays = dict(tiny_bundle.arrays)
    last = int(tiny_bundle.texel_density).bit_length() - 1
    for key in (k for k in tiled_bundle.arrays if k.startswith(("features/", "grid/"))):
        one = tiny_bundle.arrays.get(key, tiny_bundle.arrays[f"{key.split('/')[0]}/{last}"])
        arrays[key] = np.tile(one, np.floor_divide(tiled_bundle.arrays[key].shape, one.shape))
    same = replace(tiny_bundle, arrays=arrays, tiles=tiled_bundle.tiles)
    random = np.random.default_rng(1)
    uv = jnp.asarray(random.integers(-4096 * 64, 4096 * 64, (200, 2)) / 64, jnp.float32)
    radii = jnp.full(200, radius, jnp.float32)
    plain, tiled = (density(b)(uv, jnp.float32(0.5), radii)[0] for b in (tiny_bundle, same))
    np.testing.assert_allclose(tiled, plain, rtol=1e-4, atol=1e-4 * float(plain.max()))
