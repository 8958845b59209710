"""From a generator to a texture of any extent: tiles, their mips, the height feature and the σ grid.

Notation
V, U        texels of the whole texture along v and u: any
tile        TILE texels a side at most, whole patches; tiles are computed with a halo of their own, so none needs another
n_l         texels a patch of level l; a tile is whole patches, so each texel of a level lies in one tile
coarser     how many of the finest levels are not kept: what is seen from far away needs none of them
window      a tile with a patch about it: what a lookup in the tile can touch at any level
needed      which patches are wanted, (patches along v, along u): the others stay 0
nodes       of w, if geometry varies: then F(h) is made at each of them, as heights/…, and height/… is their mean

Arrays are asked for by name and sizes from `allocate` and filled tile by tile. They may lie on a disk, mapped: what is held in
memory is a tile with its halo, whatever the extent.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mesoshell.io.bundle import GRID_CELLS
from mesoshell.io.kept_textures import Allocate
from mesoshell.shell.generator.generator import Averages, Generator, synthesise, synthesise_height
from mesoshell.shell.generator.model import GeneratorModel, Latent
from mesoshell.shell.generator.nodes import window
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, reach
from mesoshell.shell.material.density_bounds import bounds, new_points
from mesoshell.shell.material.field import Layout, Material
from mesoshell.shell.material.loader import pack_heights
from mesoshell.texture import mip
from mesoshell.typing import Array

TILE, MAX_PATCHES = 512, 4
GRID_HEIGHT, PROBES, CHECKED = 16, 24, 2048


class Share(NamedTuple):
    """Of unseen points, how many lie above the σ grid, and by how much at most."""

    excess_share: float
    excess_sigma: float


def patches_a_tile(texels: int) -> int:
    """Patches along a side of a tile that is made at once, for a number of texels a patch."""
    return min(MAX_PATCHES, max(1, TILE // texels))


def bake(
    maker: GeneratorModel,
    grown: Latent,
    size: tuple[int, int],
    allocate: Allocate,
    needed: Bool[np.ndarray, "P Q"] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    coarser: int = 0,
) -> Share:
    """Fill features/…, height/…, heights/… if geometry varies, and grid/… of a texture of `size` texels (V, U), levels
    numbered from the finest that is kept."""
    texels = maker.config.texels
    levels = range(coarser, texels.bit_length())
    features = allocate("features", [(-(-size[0] >> i), -(-size[1] >> i), maker.config.channels) for i in levels])
    places = list(_places(size, texels, needed))
    for done, place in enumerate(places):
        _fill(maker, grown, place, features, size)
        progress(0.8 * (done + 1) / len(places))
    heights = _heights(maker, grown, allocate)
    return _grids(maker, features, heights, (places, size), allocate, progress)


def _heights(maker: GeneratorModel, grown: Latent, allocate: Allocate) -> list[Float[np.ndarray, "P Q _r C"]]:
    """Levels of F(h) at each node, filled a row of nodes at a time; there is one node if geometry does not vary."""
    varies = grown.w.ndim > 2
    nodes = grown.w[0] if varies else grown.w[None]
    sizes = mip.level_sizes(maker.config.height_rows, 1)
    means = allocate("height", [(r, maker.config.channels) for r, _ in sizes])
    shapes = [(*nodes.shape[:2], r, maker.config.channels) for r, _ in sizes]
    every = allocate("heights", shapes) if varies else [m[None, None] for m in means]
    sums = [np.zeros(m.shape) for m in means]
    for p, row in enumerate(nodes):
        made = _height(maker.config, maker.generator, row).swapaxes(0, 1)
        for level, total, averaged in zip(every, sums, _averaged(made.reshape(len(made), 1, -1)), strict=True):
            at_nodes = np.asarray(averaged).reshape(len(averaged), len(row), -1).swapaxes(0, 1)
            level[p] = at_nodes
            total += at_nodes.sum(axis=0)
    for mean, total in zip(means, sums, strict=True):
        mean[:] = total / (nodes.shape[0] * nodes.shape[1])
    return every


@jax.jit
def _averaged(feature: Float[Array, "V U C"]) -> list[Array]:
    return mip.build(feature)


@partial(jax.jit, static_argnums=0)
def _height(config: GeneratorConfig, generator: Generator, w: Array) -> Array:
    return synthesise_height(config, generator, w)


def _places(size: tuple[int, int], texels: int, needed: np.ndarray | None) -> Iterator[tuple[int, int]]:
    """First patches (v, u) of the tiles that are needed."""
    step = patches_a_tile(texels)
    for v in range(0, -(-size[0] // texels), step):
        for u in range(0, -(-size[1] // texels), step):
            if needed is None or needed[v : v + step, u : u + step].any():
                yield v, u


def _fill(
    maker: GeneratorModel, grown: Latent, place: tuple[int, int], features: list[np.ndarray], size: tuple[int, int]
) -> None:
    texels = maker.config.texels
    side = patches_a_tile(texels) * texels
    first = place[0] * texels, place[1] * texels
    tile = jnp.array(place, jnp.int32) * CELL
    if grown.w.ndim > 2:
        before = reach(maker.config, (side, side))
        count = side // texels + 2 * before + 1
        grown = grown._replace(w=window(grown.w, (place[0] - before, place[1] - before), count))
    feature = _tile(maker.config, side, maker.generator, maker.averages, grown, tile)
    rows, columns = (min(side, n - at) for n, at in zip(size, first, strict=True))
    levels = _levels(feature, (rows, columns), texels.bit_length() - 1)
    for i in range(texels.bit_length() - len(features), len(levels)):
        level, kept = levels[i], features[i - len(levels)]
        v, u = first[0] >> i, first[1] >> i
        kept[v : v + level.shape[0], u : u + level.shape[1]] = np.asarray(level, np.float16)


@partial(jax.jit, static_argnums=(1, 2))
def _levels(feature: Float[Array, "S S C"], size: tuple[int, int], last: int) -> list[Array]:
    """Mips of the part that lies within the texture."""
    return mip.build_open(feature[: size[0], : size[1]], last)


@partial(jax.jit, static_argnums=(0, 1))
def _tile(
    config: GeneratorConfig, side: int, generator: Generator, averages: Averages, grown: Latent, tile: Array
) -> Array:
    return synthesise(config, generator, averages, grown.w, grown.phases, tile, (side, side)).feature[0]


def _grids(
    maker: GeneratorModel,
    features: list[np.ndarray],
    heights: list[Float[np.ndarray, "P Q _r C"]],
    where: tuple[list[tuple[int, int]], tuple[int, int]],
    allocate: Allocate,
    progress: Callable[[float], None],
) -> Share:
    (places, size), step = where, patches_a_tile(maker.config.texels)
    texels = 1 << len(features) - 1
    cells = [min(GRID_CELLS, texels >> i) for i in range(len(features))]
    shapes = [(GRID_HEIGHT, *(-(-n * c // maker.config.texels) for n in size)) for c in cells]
    grids = allocate("grid", shapes)
    varies = heights[0].shape[0] > 1
    sizes = tuple(((step + 2) * (texels >> i), (step + 2) * (texels >> i)) for i in range(len(features)))
    rows, nodes = tuple((h.shape[2], 1) for h in heights), (step + 3, step + 3) if varies else None
    layout = Layout(sizes, rows, float(texels), maker.octaves, open=True, nodes=nodes)
    corner = np.array([[1.0, 1.0], [step + 1.0, step + 1.0]])
    correction = None if maker.correction is None else jnp.asarray(maker.correction)
    above, most, points = 0, 0.0, 0
    for done, place in enumerate(places):
        levels = [_window(f, place, step, texels >> i) for i, f in enumerate(features)]
        some = [window(h[None], (place[0] - 1, place[1] - 1), step + 3)[0] for h in heights] if varies else heights
        height = mip.Pyramid(jnp.asarray(pack_heights(some).reshape(-1, maker.config.channels)))
        material = Material(mip.pack([jnp.asarray(x) for x in levels]), height, maker.decoder, correction)
        for i, (grid, c) in enumerate(zip(grids, cells, strict=True)):
            bound = bounds(layout, material, i, (GRID_HEIGHT, step * c, step * c), corner, PROBES)
            v, u = place[0] * c, place[1] * c
            part = grid[:, v : v + step * c, u : u + step * c]
            part[:] = bound[:, : part.shape[1], : part.shape[2]]
            if i < 3:
                over = _over(layout, material, i, bound, c)
                above, most, points = above + int((over > 0).sum()), max(most, float(over.max())), points + len(over)
        progress(0.8 + 0.2 * (done + 1) / len(places))
    return Share(above / max(1, points), most)


def _window(level: np.ndarray, place: tuple[int, int], step: int, n: int) -> np.ndarray:
    """Texels of a level from a patch before the tile to a patch behind it; the texture's own edges are repeated."""
    rows, columns = (
        np.clip(np.arange((at - 1) * n, (at + step + 1) * n), 0, size - 1)
        for at, size in zip(place, level.shape[:2], strict=True)
    )
    return level[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1][rows - rows[0]][:, columns - columns[0]]


def _over(layout: Layout, material: Material, level: int, grid: np.ndarray, cells: int) -> np.ndarray:
    step = grid.shape[1] / cells
    key, place = jax.random.key(1000 + level), (jnp.ones(2), jnp.full(2, step))
    xi, sigma = new_points(layout, material, np.float32(level), CHECKED, place, key)
    relative = (np.asarray(xi) - [1, 1, 0]) / [step, step, 1]
    shape = np.array(grid.shape)
    cell = np.minimum((relative[:, ::-1] * shape).astype(int), shape - 1)
    return np.asarray(sigma) - grid.astype(np.float32)[tuple(cell.T)]
