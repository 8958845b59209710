"""σ of a material's finest level in a grid (io/density_grid), made and read in JAX.

Notation
S, K, α     as in io/density_grid
(i, j, k)   a place of the grid: column, line and row, from the texture's border and from the base
"""

import itertools
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.io.density_grid import K, in_half, kept_grid
from mesoshell.numerics import product
from mesoshell.shell.material.corner_tiles import Origin
from mesoshell.shell.material.decoder import trunk
from mesoshell.shell.material.field import Layout, Material, Point
from mesoshell.shell.material.lattice import inputs_on_lattice
from mesoshell.shell.material.loader import DeviceMaterial
from mesoshell.typing import Array, Scalar, Vec3

#: Columns that are decoded together, about.
TOGETHER = 4096
#: Grids that a material keeps, those that were used last.
MOST = 4

Shape = tuple[int, ...]


def baked_density(
    device_material: DeviceMaterial, alpha: Float[np.ndarray, "A"], varying: tuple[int, ...], shape: Shape
) -> Float[Array, "N"]:
    """A material's grid, from the cache or made. varying: positions in α of what varies."""
    values = tuple(None if i in varying else float(a) for i, a in enumerate(alpha))
    key = values, shape
    known = device_material.densities
    grid = known.pop(key, None)
    if grid is None:
        of = "jax", jax.default_backend(), device_material.digest, values
        made = kept_grid(of, shape, partial(bake, device_material, values, shape))
        grid = jnp.asarray(made)
    for old in list(known)[: max(0, len(known) + 1 - MOST)]:
        known.pop(old, None)
    known[key] = grid
    return grid


def bake(device_material: DeviceMaterial, values: tuple[float | None, ...], shape: Shape) -> Float[np.ndarray, "N"]:
    """The numbers of a grid. values: of α, None for one that varies."""
    layout = replace(device_material.layout, colours=None)  # of corner tiles: their torus
    material = device_material.material_for(filtering=False)._replace(origin=None)
    lines, columns = shape[-3:-1]
    together = max(1, TOGETHER // columns)
    ends = itertools.product((0.0, 1.0), repeat=values.count(None))
    work = [(_alpha(values, end), first) for end in ends for first in range(0, lines, together)]

    def some(item: tuple[np.ndarray, int]) -> np.ndarray:
        alpha, first = item
        found = _lines(layout, (together, columns), material, jnp.asarray(alpha), np.int32(first))
        return in_half(np.asarray(found)[: lines - first]).ravel()

    first = some(work[0])  # compiles
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.concatenate([first, *pool.map(some, work[1:])])


def _alpha(values: tuple[float | None, ...], end: tuple[float, ...]) -> np.ndarray:
    given = iter(end)
    return np.array([next(given) if a is None else a for a in values], np.float32)


@partial(jax.jit, static_argnums=(0, 1))
def _lines(layout: Layout, size: tuple[int, int], material: Material, alpha: Array, first: Array) -> Array:
    """σ of some of the grid's lines, from the first: (lines, columns, K)."""
    line, column = (jnp.arange(n, dtype=jnp.int32) for n in size)
    fine = size[1] / layout.sizes[0][1]  # columns a texel
    if layout.open:
        patches = (1 / (fine * layout.texel_density),) * 2
    else:
        patches = tuple(layout.period / (fine * n) for n in layout.sizes[0])
    v, u = ((at.astype(jnp.float32) + 0.5) * wide for at, wide in zip((first + line, column), patches, strict=True))
    zero = jnp.float32(0)

    def layer(h: Scalar) -> Array:
        x = inputs_on_lattice(material, layout, v, u, Point(jnp.stack([zero, zero, h]), zero, zero, alpha))
        return trunk(material.decoder, x)[0]

    heights = (jnp.arange(K, dtype=jnp.float32) + 0.5) / K
    return jnp.moveaxis(jax.lax.map(layer, heights), 0, -1)


def sigma_at(
    layout: Layout,
    shape: Shape,
    numbers: Float[Array, "N"],
    xi: Vec3,
    alpha: Float[Array, "V"],
    origin: Origin | None,
) -> Scalar:
    """σ at ξ. alpha: of the parameters that vary; origin: of the material."""
    lines, columns = shape[-3:-1]
    uv = layout.on_texture(xi[:2], origin)
    if layout.open:
        x, y = uv * (columns / layout.sizes[0][1] * layout.texel_density)
    else:
        x, y = (uv - jnp.floor(uv)) * jnp.array([columns, lines], uv.dtype)
    places = [(alpha[i], 2, False) for i in range(len(shape) - 3)]
    places += [(y - 0.5, lines, not layout.open), (x - 0.5, columns, not layout.open), (xi[2] * K - 0.5, K, False)]
    index, weight = jnp.zeros(1, jnp.int32), jnp.ones(1, xi.dtype)
    for place, size, wraps in places:
        around, share = _neighbours(place, size, wraps)
        index = (index[:, None] * size + around[None]).ravel()
        weight = (weight[:, None] * share[None]).ravel()
    return product(weight, numbers[index].astype(xi.dtype))


def _neighbours(place: Scalar, size: int, wraps: bool) -> tuple[Array, Array]:
    """The two places of an axis around one, and their weights."""
    place = place if wraps else jnp.clip(place, 0, size - 1)
    below = jnp.floor(place)
    both = below.astype(jnp.int32) + jnp.arange(2, dtype=jnp.int32)
    both = jnp.mod(both, size) if wraps else jnp.minimum(both, size - 1)
    return both, jnp.stack([1 - (place - below), place - below])
