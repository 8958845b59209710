"""The σ grid: what lets a render pass over empty space.

Notation
cell        of (h, v, u); it holds MARGIN times the largest σ that was seen in it, its walls' surroundings included
l           level: grid l bounds σ for levels in [l, l + 1)
excess      of σ over the bound, at points that no probe saw

σ is the decoder's, of features that are interpolated: it has no cheap bound. So each cell is probed in random places, a tenth
of a cell beyond its walls included, at random fractions of a level, heights' filters, parameters, and corrections of up to
two levels more, as taps along an ellipse have them; half of the probes at the level itself, since unfiltered features have the
greatest extremes and all of a close view is unfiltered.

A probe is drawn for all cells of one height together: they are looked up as a lattice (lattice.py), at a third of the cost.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.shell.material.decoder import trunk
from mesoshell.shell.material.field import Layout, Material, Point, neural_field
from mesoshell.shell.material.lattice import inputs_on_lattice
from mesoshell.typing import Array, Float, Key

MARGIN = 1.5
#: The largest deviation along the height that is probed: what each of 16 samples through a layer stands for, at a slant.
MAX_DEVIATION = 0.05
#: Cells along an axis that are probed at least.
FEWEST = 4
#: Cells that are decoded together, about.
_TOGETHER = 2**14


def bounds(
    layout: Layout,
    material: Material,
    level: int,
    shape: tuple[int, int, int],
    corner: Float[np.ndarray, "2 2"],
    probes: int,
) -> Float[np.ndarray, "h v u"]:
    """Bounds, in half precision, of the cells of a rectangle of the texture. corner: its least and greatest (u, v)."""
    layers, lines, columns = shape
    wide = layers, max(lines, FEWEST), max(columns, FEWEST)  # one program for all small levels
    place = np.float32(corner[0]), np.float32((corner[1] - corner[0]) / (columns, lines))
    largest = _largest(layout, material, np.float32(level), wide, probes, place, jax.random.key(level))
    return rounded_up(np.asarray(largest)[:, :lines, :columns] * MARGIN)


def rounded_up(sigma: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Half precision of which four bits of the mantissa are kept, so at most 1/16 more: a file packs it in half the space."""
    bits = np.minimum(sigma, np.finfo(np.float16).max).astype(np.float16).view(np.uint16)
    return np.minimum((bits + 0x3F) & 0xFFC0, 0x7BC0).astype(np.uint16).view(np.float16)


@partial(jax.jit, static_argnums=(0, 3, 4))
def _largest(
    layout: Layout,
    material: Material,
    level: Array,
    shape: tuple[int, int, int],
    probes: int,
    place: tuple[Array, Array],
    key: Key[Array, ""],
) -> Float[Array, "h v u"]:
    """The largest σ of each cell's probes. place: least (u, v), and the size of a cell."""
    (low, cell), (layers, lines, columns) = place, shape

    def layer(at: tuple[Array, Array]) -> Float[Array, "v u"]:
        k = jax.random.split(at[1])
        inside = jax.random.uniform(k[0], (3,), minval=-0.1, maxval=1.1)
        u, v = (
            low[i] + (jnp.arange(n, dtype=jnp.float32) + inside[i]) * cell[i] for i, n in enumerate((columns, lines))
        )
        h = jnp.clip((at[0] + inside[2]) / layers, 0, 1)
        point = Point(jnp.stack([low[0], low[1], h]), *_drawn(layout, material, level, k[1], ()))
        return trunk(material.decoder, inputs_on_lattice(material, layout, v, u, point))[0]

    def probe(i: Array, largest: Array) -> Array:
        keys = jax.random.split(jax.random.fold_in(key, i), layers)
        some = max(1, min(layers, _TOGETHER // (lines * columns)))
        found = jax.lax.map(layer, (jnp.arange(layers, dtype=jnp.float32), keys), batch_size=some)
        return jnp.maximum(largest, found)

    return jax.lax.fori_loop(0, probes, probe, jnp.zeros(shape, jnp.float32))


@partial(jax.jit, static_argnums=(0, 3))
def new_points(
    layout: Layout, material: Material, level: Array, count: int, place: tuple[Array, Array], key: Key[Array, ""]
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:
    """Random points of a rectangle (its least (u, v) and its size) and σ there."""
    k = jax.random.split(key)
    xi = jax.random.uniform(k[0], (count, 3))
    xi = xi.at[:, :2].set(place[0][None] + xi[:, :2] * place[1][None])
    return xi, _sigma(layout, material, xi, level, k[1])


def _sigma(layout: Layout, material: Material, xi: Array, level: Array, key: Array) -> Array:
    points = Point(xi.at[:, 2].set(jnp.clip(xi[:, 2], 0, 1)), *_drawn(layout, material, level, key, xi.shape[:1]))
    return jax.lax.map(lambda p: neural_field(material, layout).density(p)[0], points, batch_size=4096)


def _drawn(
    layout: Layout, material: Material, level: Array, key: Key[Array, ""], shape: tuple[int, ...]
) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n A"], Float[Array, "*n"]]:
    """Radii of level `level` up to the next, deviations along the height, appearances, and spreads."""
    k = jax.random.split(key, 4)
    at = level + jnp.maximum(jax.random.uniform(k[0], shape, minval=-1.0), 0)
    radius = jnp.where(at == 0, 0.0, 2.0**at / (2 * layout.texel_density))
    encoded = layout.octaves * 2 + 1 + material.texture.rows.shape[1]
    alpha = jax.random.uniform(k[2], (*shape, material.decoder.trunk[0].kernel.shape[0] - encoded))
    spread = radius * 4.0 ** jax.random.uniform(k[3], shape)
    return radius, jax.random.uniform(k[1], shape, maxval=MAX_DEVIATION), alpha, spread
