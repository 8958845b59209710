"""A lattice of lookups is as many lookups of a point: with edges and around them, where geometry varies, of planes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.shell.material.corner_tiles import as_origin
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.shell.material.density_bounds import MARGIN, bounds, new_points
from mesoshell.shell.material.field import Layout, Material, Point, inputs
from mesoshell.shell.material.lattice import inputs_on_lattice
from mesoshell.texture import mip

C, SIZES, HEIGHTS, NODES = 3, ((8, 16), (4, 8), (2, 4), (1, 2), (1, 1)), mip.level_sizes(4, 1), (3, 4)
LAYOUT = Layout(SIZES, HEIGHTS, 8.0, 1)
LAYOUTS = {
    "around": replace(LAYOUT, sizes=mip.level_sizes(8, 8)),
    "edges": replace(LAYOUT, open=True),
    "nodes": replace(LAYOUT, open=True, nodes=NODES),
    "corrected": replace(LAYOUT, sizes=mip.level_sizes(8, 8)),
    "planes": replace(LAYOUT, sizes=mip.level_sizes(8, 8), open=True, cells=(2, 2)),
}


def material_of(layout: Layout, corrected: bool = False) -> Material:
    """Noise, with rows enough for any layout."""
    rng = np.random.default_rng(0)
    texture, height = (mip.Pyramid(jnp.asarray(rng.normal(size=(2000, C)), jnp.float32)) for _ in range(2))
    correction = jnp.asarray(rng.normal(size=(len(layout.sizes), 6, C)), jnp.float32)
    decoder = init_decoder(jax.random.key(0), C + 1 + 2 + 2, (8,), (8,))
    return Material(texture, height, decoder, correction if corrected else None, as_origin((-1, 2)))


@pytest.mark.parametrize("radius", [0.0, 0.11, 0.4, 1e9])
@pytest.mark.parametrize("name", LAYOUTS)
def test_every_place_is_looked_up_as_a_point(name: str, radius: float) -> None:
    layout, material = LAYOUTS[name], material_of(LAYOUTS[name], name == "corrected")
    v, u = jnp.asarray([-0.7, 0.0, 0.31, 0.99, 3.3]), jnp.asarray([-1.2, 0.03, 0.5, 1.77])
    at = Point(jnp.zeros(3).at[2].set(0.37), jnp.asarray(radius), jnp.asarray(0.2), jnp.asarray([0.2, 0.9]))
    found = jax.jit(lambda: inputs_on_lattice(material, layout, v, u, at))()
    one = lambda v, u: inputs(material, layout, at._replace(xi=jnp.stack([u, v, at.xi[2]])))  # noqa: E731
    expected = jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))(v, u)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("level", [0, 2])
def test_bounds_hold_where_no_probe_looked(level: int) -> None:
    """But for a few points in a thousand; and they are no higher than the margin over what is there."""
    layout = replace(LAYOUT, sizes=mip.level_sizes(8, 8))
    material = material_of(layout)
    shape, corner = (4, 4, 4), np.array([[0.0, 0.0], [1.0, 1.0]])
    grid = bounds(layout, material, level, shape, corner, 24).astype(np.float32)
    xi, sigma = new_points(layout, material, jnp.float32(level), 20_000, (jnp.zeros(2), jnp.ones(2)), jax.random.key(5))
    cell = tuple(np.minimum((np.asarray(xi)[:, ::-1] * 4).astype(int), 3).T)
    assert (np.asarray(sigma) > grid[cell]).mean() < 0.005
    assert grid.max() <= 1.001 * MARGIN * 17 / 16 * float(jnp.max(sigma)) * 1.05
