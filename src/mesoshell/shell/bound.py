"""The σ grid: what lets a render pass over empty space (floor 4).

Alphabet
cell        of (h, v, u); it holds MARGIN times the largest σ that was seen in it, its walls' surroundings included
l           level: grid l bounds σ for levels in [l, l + 1)
excess      of σ over the bound, at points that no probe saw

σ is the decoder's, of features that are interpolated: it has no cheap bound. So each cell is probed in random places, a tenth
of a cell beyond its walls included, at random fractions of a level, heights' filters and parameters; half of the probes at the
level itself, since unfiltered features have the greatest extremes and all of a close view is unfiltered.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.shell.field import Layout, Material, Point, neural_field
from mesoshell.typing import Array, Float, Key

MARGIN = 1.5
#: The largest deviation along the height that is probed: what each of 16 samples through a layer stands for, at a slant.
DEEPEST = 0.05


def bounds(
    layout: Layout,
    material: Material,
    level: int,
    shape: tuple[int, int, int],
    corner: Float[np.ndarray, "2 2"],
    probes: int,
) -> Float[np.ndarray, "h v u"]:
    """Bounds, in half precision, of the cells of a rectangle of the texture. corner: its least and greatest (u, v)."""
    largest = jnp.zeros(shape)
    low, size = jnp.asarray(corner[0], jnp.float32), jnp.asarray(corner[1] - corner[0], jnp.float32)
    for key in jax.random.split(jax.random.key(level), probes):
        largest = jnp.maximum(largest, _seen(layout, material, np.float32(level), shape, (low, size), key))
    return np.minimum(np.asarray(largest) * MARGIN, np.finfo(np.float16).max).astype(np.float16)


@partial(jax.jit, static_argnums=(0, 3))
def _seen(
    layout: Layout, material: Material, level: Array, shape: tuple[int, int, int], place: tuple, key: Array
) -> Array:
    """σ at one random point of each cell."""
    k = jax.random.split(key)
    cells = jnp.stack(jnp.meshgrid(*(jnp.arange(n, dtype=jnp.float32) for n in shape), indexing="ij"), -1)
    inside = cells + jax.random.uniform(k[0], cells.shape, minval=-0.1, maxval=1.1)
    relative = (inside.reshape(-1, 3) / jnp.array([shape], jnp.float32))[:, ::-1]
    xi = relative.at[:, :2].set(place[0][None] + relative[:, :2] * place[1][None])
    return _sigma(layout, material, xi, level, k[1]).reshape(shape)


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
    k, n = jax.random.split(key, 3), xi.shape[0]
    at = level + jnp.maximum(jax.random.uniform(k[0], (n,), minval=-1.0), 0)
    radius = jnp.where(at == 0, 0.0, 2.0**at / (2 * layout.texel_density))
    deviation = jax.random.uniform(k[1], (n,), maxval=DEEPEST)
    encoded = layout.octaves * 2 + 1 + material.texture.rows.shape[1]
    alpha = jax.random.uniform(k[2], (n, material.decoder.trunk[0].kernel.shape[0] - encoded))
    points = Point(xi.at[:, 2].set(jnp.clip(xi[:, 2], 0, 1)), radius, deviation, alpha)
    return jax.lax.map(lambda p: neural_field(material, layout).density(p)[0], points, batch_size=4096)
