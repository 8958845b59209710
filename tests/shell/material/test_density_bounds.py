"""The grid that skipping rests on: the bundled grass's bounds hold where the probes that made them did not look."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.shell.material.density_bounds import MAX_DEVIATION, new_points, rounded_up
from mesoshell.shell.material.loader import load_device_material
from mesoshell.texture.footprint import footprint


@pytest.mark.parametrize("level", range(9))
def test_density_stays_below_the_bounds_at_every_level(level: int) -> None:
    """But for one point in two hundred. Bounds that were probed with heights blurred as by a cone had 1 in 20 above them."""
    bundle = read_bundle(find("grass"))
    held, grid = load_device_material(bundle), bundle.arrays[f"grid/{level}"].astype(np.float32)
    place = jnp.zeros(2), jnp.ones(2)
    xi, sigma = new_points(held.layout, held.material, jnp.float32(level), 40_000, place, jax.random.key(7 + level))
    shape = np.array(grid.shape)
    cell = np.minimum((np.asarray(xi)[:, ::-1] * shape).astype(int), shape - 1)
    assert (np.asarray(sigma) > grid[tuple(cell.T)]).mean() < 0.005


def test_what_is_probed_is_what_16_samples_see() -> None:
    """Through a layer of height 1, straight down or at 60 degrees, from any distance."""
    for cosine in (1.0, 0.5):
        d = jnp.float32([(1 - cosine**2) ** 0.5, 0, -cosine])
        step = 1 / cosine / 16
        assert float(footprint(jnp.eye(3), d, jnp.float32(step**2 / 12), jnp.float32(4.0)).height) <= MAX_DEVIATION


def test_rounding_a_bound_never_lowers_it() -> None:
    """By half precision's own rounding at most; and raises it by 1/16 at most. What no half can hold gets the largest bound."""
    sigma = np.geomspace(1e-4, 6e4, 30_001, dtype=np.float32)
    ratio = rounded_up(sigma).astype(np.float64) / sigma
    assert ratio.min() > 1 - 2**-10
    assert ratio.max() < 1 + 2**-4 + 2**-10
    assert (rounded_up(np.asarray([0.0, 6.5e4, 1e30], np.float32)) == np.asarray([0.0, 63488.0, 63488.0])).all()
