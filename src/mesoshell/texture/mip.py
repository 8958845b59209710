"""Feature pyramids and their filtered lookup, in two dimensions and in one.

Notation
F           features, level 0 first; each level the box average of 2 × 2 texels (2 in 1D) of the one before
(u, v)      texture coordinates in patches; the texture covers one patch and wraps around, or it has `density` texels a
            patch, begins at (0, 0) and repeats its last texels beyond its edges; v grows along axis 0; or it holds tiles, each
            a patch with `density` texels, of which a plane shows one at each patch
h           height in [0, 1]; the height feature is clamped at its ends
λ           level, 0 = finest; level = max(0, log2(2r · texel_density)), r one standard deviation of the footprint in patches
C           channels

A lookup costs as much as the network that follows it, and nearly all of that is waiting for memory. So every texel is stored
once: rows that hold a texel's 2 × 2 neighbourhood side by side, two wide gathers in place of eight narrow ones, took 1.6
times as long in a render, because the table is then too large for the cache. Values lie at texel centres.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.typing import Array, Float, Int, Scalar, Vec2


class Pyramid(NamedTuple):
    """Texels of all levels, finest first, one a row: (ΣH_l·W_l, C) in 2D, (ΣR_l, C) in 1D. Sizes are static."""

    rows: Float[Array, "T C"]


#: Sizes (H, W) of a pyramid's levels: static, so that they are constants of the compiled program.
Sizes = tuple[tuple[int, int], ...]


def level_sizes(height: int, width: int) -> Sizes:
    """(H, W) of each level down to 1 × 1, halving (at least 1)."""
    sizes = [(height, width)]
    while sizes[-1] != (1, 1):
        sizes.append((max(1, sizes[-1][0] // 2), max(1, sizes[-1][1] // 2)))
    return tuple(sizes)


def build(feature: Float[Array, "H W C"]) -> list[Float[Array, "_h _w C"]]:
    """All levels of a 2D pyramid by box averages. H and W are powers of two. A 1D feature (R, C) goes in as (R, 1, C)."""
    levels = [feature]
    for h, w in level_sizes(*feature.shape[:2])[1:]:
        last = levels[-1]
        levels.append(last.reshape(h, last.shape[0] // h, w, last.shape[1] // w, -1).mean(axis=(1, 3)))
    return levels


def build_open(feature: Float[Array, "H W C"], last: int) -> list[Float[Array, "_h _w C"]]:
    """Levels 0 to `last` of a texture with edges, of any size: sides halve upward, an odd one repeats its last texel."""
    levels = [feature]
    for _ in range(last):
        x = levels[-1]
        x = jnp.pad(x, ((0, x.shape[0] % 2), (0, x.shape[1] % 2), (0, 0)), mode="edge")
        levels.append(x.reshape(x.shape[0] // 2, 2, x.shape[1] // 2, 2, -1).mean(axis=(1, 3)))
    return levels


def pack(levels: list[Float[Array, "_h _w C"]]) -> Pyramid:
    """A pyramid's levels, in 2D or 1D, as one table."""
    return Pyramid(jnp.concatenate([level.reshape(-1, level.shape[-1]) for level in levels]))


def level_of(radius: Scalar, texel_density: float, last: int) -> Scalar:
    """Level at which a texel is as wide as the footprint's ±1 standard deviation; NaN counts as 0, infinity as the last."""
    width = 2 * radius * texel_density
    finite = jnp.clip(jnp.where(jnp.isnan(width), 1.0, width), 1.0, 2.0**last)
    return jnp.log2(finite)


def _split(level: Scalar, last: int) -> tuple[Array, Scalar]:
    """Lower level as an integer, and the fraction toward the next."""
    level = jnp.clip(jnp.where(jnp.isnan(level), 0.0, level), 0, last)
    lower = jnp.floor(level)
    return lower.astype(jnp.int32), level - lower


def lookup(
    pyramid: Pyramid,
    sizes: Sizes,
    uv: Vec2,
    level: Scalar,
    density: float | None = None,
    first: Array | int = 0,
    tile: Callable[[Int[Array, "2"]], Int[Array, "2"]] | None = None,
) -> Float[Array, "C"]:
    """Trilinear F(u, v) at a level in [0, number of levels − 1], as float32. density: of a texture with edges, or of tiles;
    first: row at which one of several such pyramids in a table begins; tile: where in the texture a patch of the plane lies."""
    last = len(sizes) - 1
    lower, fraction = _split(level, last)
    bilinear = _bilinear if density is None else partial(_bilinear_open, density=density, first=first)
    if density is not None and tile is not None:
        bilinear = partial(_bilinear_tiled, density=density, tile=tile)
    low, high = (bilinear(pyramid, sizes, uv, l) for l in (lower, jnp.minimum(lower + 1, last)))
    return (1 - fraction) * low + fraction * high


def lookup_lattice(
    pyramid: Pyramid,
    sizes: Sizes,
    v: Float[Array, "V"],
    u: Float[Array, "U"],
    level: Scalar,
    density: float | None = None,
) -> Float[Array, "V U C"]:
    """What `lookup` gives at all (u, v) of two axes, at one level. Neighbours follow each other in memory."""
    offsets, shapes = _tables(sizes)
    lower, fraction = _split(level, len(sizes) - 1)
    total = jnp.zeros((len(v), len(u), pyramid.rows.shape[1]), jnp.float32)
    for l, share in ((lower, 1 - fraction), (jnp.minimum(lower + 1, len(sizes) - 1), fraction)):
        lines, columns = (_on_axis(at, l, shapes[l, axis], density) for axis, at in enumerate((v, u)))
        for line, wv in lines:
            for column, wu in columns:
                row = offsets[l] + line[:, None] * shapes[l, 1] + column[None]
                weight = share * wv[:, None] * wu[None]
                total += weight[..., None] * pyramid.rows[row].astype(jnp.float32)
    return total


def _on_axis(at: Float[Array, "n"], level: Array, size: Array, density: float | None) -> list[tuple[Array, Array]]:
    """The two texels around each position on an axis of `size` texels, and their weights."""
    if density is None:
        x = (at - jnp.floor(at)) * size.astype(at.dtype) - 0.5
    else:
        x = at * (jnp.exp2(-level.astype(at.dtype)) * density) - 0.5
        x = jnp.clip(x, 0, (size - 1).astype(at.dtype))
    first, f = jnp.floor(x).astype(jnp.int32), x - jnp.floor(x)
    both = jnp.stack([first, first + 1])
    before, behind = jnp.mod(both, size) if density is None else jnp.minimum(both, size - 1)
    return [(before, 1 - f), (behind, f)]


def _bilinear(pyramid: Pyramid, sizes: Sizes, uv: Vec2, level: Array) -> Float[Array, "C"]:
    offsets, shapes = _tables(sizes)
    h, w = shapes[level]
    wrapped = uv - jnp.floor(uv)  # first: whole patches must not cost precision
    x, y = wrapped[0] * w.astype(uv.dtype) - 0.5, wrapped[1] * h.astype(uv.dtype) - 0.5
    xi, yi = jnp.floor(x), jnp.floor(y)
    fx, fy = x - xi, y - yi
    column, line = xi.astype(jnp.int32), yi.astype(jnp.int32)
    columns, lines = jnp.mod(column + jnp.array([0, 1, 0, 1]), w), jnp.mod(line + jnp.array([0, 0, 1, 1]), h)
    return _weighted(_corner_weights(fx, fy), pyramid.rows[offsets[level] + lines * w + columns])


def _bilinear_open(
    pyramid: Pyramid, sizes: Sizes, uv: Vec2, level: Array, density: float, first: Array | int
) -> Float[Array, "C"]:
    offsets, shapes = _tables(sizes)
    h, w = shapes[level]
    scale = jnp.exp2(-level.astype(uv.dtype)) * density
    x = jnp.clip(uv[0] * scale - 0.5, 0, (w - 1).astype(uv.dtype))
    y = jnp.clip(uv[1] * scale - 0.5, 0, (h - 1).astype(uv.dtype))
    xi, yi = jnp.floor(x), jnp.floor(y)
    columns = jnp.minimum(xi.astype(jnp.int32) + jnp.array([0, 1, 0, 1]), w - 1)
    lines = jnp.minimum(yi.astype(jnp.int32) + jnp.array([0, 0, 1, 1]), h - 1)
    return _weighted(_corner_weights(x - xi, y - yi), pyramid.rows[first + offsets[level] + lines * w + columns])


def _bilinear_tiled(
    pyramid: Pyramid,
    sizes: Sizes,
    uv: Vec2,
    level: Array,
    density: float,
    tile: Callable[[Int[Array, "2"]], Int[Array, "2"]],
) -> Float[Array, "C"]:
    """Read each of the four texels from the tile at its own patch. Where a texel spans patches, all tiles are alike."""
    offsets, shapes = _tables(sizes)
    h, w = shapes[level]
    texels = jnp.maximum(jnp.int32(density) >> level, 1)  # a patch
    patch = jnp.floor(uv)
    x = (uv - patch) * texels.astype(uv.dtype) - 0.5
    first = jnp.floor(x)
    fx, fy = x - first
    at = first.astype(jnp.int32)[None] + jnp.array([[0, 0], [1, 0], [0, 1], [1, 1]])  # from -1 to `texels`
    apart = jnp.floor_divide(at, texels)
    place = jax.vmap(tile)(patch.astype(jnp.int32)[None] + apart)
    column, line = (place * texels + at - apart * texels).T
    row = jnp.minimum(line, h - 1) * w + jnp.minimum(column, w - 1)
    return _weighted(_corner_weights(fx, fy), pyramid.rows[offsets[level] + row])


def _weighted(weights: Float[Array, "K"], rows: Float[Array, "K C"]) -> Float[Array, "C"]:
    return jnp.matmul(weights, rows.astype(jnp.float32), precision="highest")


def _corner_weights(fx: Scalar, fy: Scalar) -> Float[Array, "4"]:
    return jnp.stack([1 - fx, fx, 1 - fx, fx]) * jnp.stack([1 - fy, 1 - fy, fy, fy])


def lookup_height(
    pyramid: Pyramid, sizes: Sizes, h: Scalar, level: Scalar, first: Array | int = 0
) -> Float[Array, "C"]:
    """Bilinear F(h) in height and level, as float32. `sizes` has rows (R, 1); first: as in `lookup`."""
    last = len(sizes) - 1
    lower, fraction = _split(level, last)
    low, high = (_linear(pyramid, sizes, h, l, first) for l in (lower, jnp.minimum(lower + 1, last)))
    return (1 - fraction) * low + fraction * high


def _linear(pyramid: Pyramid, sizes: Sizes, h: Scalar, level: Array, above: Array | int) -> Float[Array, "C"]:
    offsets, shapes = _tables(sizes)
    rows = shapes[level, 0]
    z = jnp.clip(h * rows.astype(h.dtype) - 0.5, 0, (rows - 1).astype(h.dtype))
    zi = jnp.floor(z)
    first, f = zi.astype(jnp.int32), z - zi
    both = pyramid.rows[above + offsets[level] + jnp.minimum(first + jnp.array([0, 1]), rows - 1)]
    return _weighted(jnp.stack([1 - f, f]), both)


def _tables(sizes: Sizes) -> tuple[Array, Array]:
    shapes = np.array(sizes, np.int32)
    offsets = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))[:-1]]).astype(np.int32)
    return jnp.asarray(offsets), jnp.asarray(shapes)
