"""The compiled parts of the renderer: one program for each evaluation of many samples.

Each kernel works on padded arrays of a fixed capacity and a count, in tiles (`nets/mlp.in_tiles`), so that it is compiled
once whatever the scene. An effect is traced only if it is on: `StaticConfig` is a static argument, and two
scenes that call for the same effects share a compiled program.

Notation
S           samples: each is an interval's row, a position f on it, and the share of the interval it stands for
τ           optical depth of a sample, σ times the canonical length it stands for
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.io.bundle import GRID_CELLS
from mesoshell.nets.mlp import in_tiles
from mesoshell.numerics import optical_depth, product, safe_div, safe_sqrt
from mesoshell.shell.geometry.sampling import Chart, Frame, Piece, frame, place, place_exact
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.baked_density import sigma_at
from mesoshell.shell.material.field import Layout, Material, Point, correction, inputs
from mesoshell.shell.material.loader import Grid
from mesoshell.texture import mip
from mesoshell.texture.footprint import Footprint
from mesoshell.typing import Array, Float, Scalar, Vec3


@dataclass(frozen=True)
class StaticConfig:
    """What is compiled: the material's layout, and which effects the scene calls for. Hashable, a static argument."""

    layout: Layout
    grid_shapes: tuple[tuple[int, int, int], ...]
    filtering: bool
    taps: int
    exact: bool
    maps: tuple[int, ...]  # positions in α that vary over the surface
    baked: tuple[int, ...] | None = None  # shape of the grid that σ is read from


class DeviceTables(NamedTuple):
    """Everything a kernel reads that is not per sample. maps: repeated over the UV square; cone: of a pixel, times
    `Quality.footprint`; height_filter: of `Quality`; baked: the grid of σ, if it is read from one."""

    chart: Chart
    material: Material
    grid: Grid
    alpha: Float[Array, "A"]
    maps: tuple[Float[Array, "_ _"], ...]
    patches_per_uv: Scalar
    cone: Scalar
    height_filter: Scalar
    baked: Float[Array, "N"] | None = None


class Samples(NamedTuple):
    """Samples: row of the interval, position f on it, share of it, canonical length it stands for; NumPy or JAX, (S,) each."""

    row: Any
    f: Any
    share: Any
    step: Any


@jax.jit
def frames(chart: Chart, pieces: Piece, count: Array) -> Frame:
    """Canonical frames of intervals."""
    like = ((3, jnp.float32), (3, jnp.float32), (0, jnp.float32), (9, jnp.float32))

    def tile(p: Piece) -> tuple:
        frames = jax.vmap(frame, in_axes=(None, 0))(chart, p)
        return frames.xi0, frames.xi1, frames.length, frames.inverse.reshape(-1, 9)

    xi0, xi1, length, inverse = in_tiles(tile, count, (pieces,), like)
    return Frame(xi0, xi1, length, inverse.reshape(-1, 3, 3))


def _sample(program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, s: Samples) -> tuple[Vec3, Footprint]:
    piece, here = jax.tree.map(lambda x: x[s.row], (pieces, at))
    placed = place(piece, here, s.f, s.share, table.cone)
    xi = place_exact(table.chart, piece, s.f) if program.exact else placed.xi
    wide = placed.footprint
    return xi, wide._replace(height=table.height_filter * wide.height)


def level_of_footprint(program: StaticConfig, footprint: Footprint) -> Scalar:
    """The level of the texture at which a texel is as wide as a footprint; 0 without filtering."""
    if not program.filtering:
        return jnp.zeros_like(footprint.minor)
    return mip.level_of(footprint.minor, program.layout.texel_density, len(program.layout.sizes) - 1)


def bound(program: StaticConfig, grid: Grid, xi: Vec3, level: Scalar) -> Scalar:
    """Largest σ that the material can have near ξ at this level."""
    shapes = jnp.array(program.grid_shapes, jnp.int32)
    sizes = [a * b * c for a, b, c in program.grid_shapes]
    offsets = jnp.array([sum(sizes[:i]) for i in range(len(sizes))], jnp.int32)
    l = jnp.floor(level).astype(jnp.int32)
    if program.layout.open:
        uv, patches = program.layout.on_texture(xi[:2], grid.origin), jnp.array(_cells(program.layout), xi.dtype)
        where = jnp.stack([xi[2] * shapes[l, 0].astype(xi.dtype), uv[1] * patches[l], uv[0] * patches[l]])
    else:
        uv = program.layout.on_texture(xi[:2], grid.origin)
        uv = uv - jnp.floor(uv)
        where = jnp.stack([xi[2], uv[1], uv[0]]) * shapes[l].astype(xi.dtype)
    cell = jnp.clip(where.astype(jnp.int32), 0, shapes[l] - 1)
    return grid.values[offsets[l] + (cell[0] * shapes[l, 1] + cell[1]) * shapes[l, 2] + cell[2]]


def _cells(layout: Layout) -> tuple[int, ...]:
    """Cells a patch of each level's grid, of a texture with edges."""
    return tuple(min(GRID_CELLS, max(1, int(layout.texel_density) >> i)) for i in range(len(layout.sizes)))


@partial(jax.jit, static_argnums=0)
def depth_bounds(
    program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, samples: Samples, count: Array
) -> Array:
    """Largest optical depth each sample can have: those below their share of `Quality.skip` need not be decoded."""

    def tile(s: Samples) -> tuple[Array]:
        def one(s: Samples) -> Scalar:
            xi, footprint = _sample(program, table, pieces, at, s)
            return bound(program, table.grid, xi, level_of_footprint(program, footprint)) * s.step

        return (jax.vmap(one)(s),)

    return in_tiles(tile, count, (samples,), ((0, jnp.float32),))[0]


def _alpha(program: StaticConfig, table: DeviceTables, xi: Vec3) -> Array:
    alpha = table.alpha
    if not program.maps:
        return alpha
    uv = xi[:2] / table.patches_per_uv
    uv = uv - jnp.floor(uv)
    for position, image in zip(program.maps, table.maps, strict=True):
        height, width = image.shape
        column = jnp.minimum((uv[0] * width).astype(jnp.int32), width - 1)
        row = jnp.minimum(((1 - uv[1]) * height).astype(jnp.int32), height - 1)  # images have v = 1 at the top
        alpha = alpha.at[position].set(image[row, column])
    return alpha


def _inputs(program: StaticConfig, table: DeviceTables, xi: Vec3, footprint: Footprint) -> Array:
    """Decoder inputs of a sample; with several taps, features are averaged along the footprint's long axis."""
    alpha = _alpha(program, table, xi)
    zero = jnp.zeros_like(footprint.minor)
    if not program.filtering:
        return inputs(table.material, program.layout, Point(xi, zero, zero, alpha))
    if program.taps == 1:
        return inputs(table.material, program.layout, Point(xi, footprint.minor, footprint.height, alpha))
    positions, weights = gaussian_taps(program.taps)
    spacing = footprint.major * (positions[1] - positions[0])
    radius = jnp.minimum(jnp.maximum(footprint.minor, 0.35 * spacing), footprint.major)
    reach = safe_sqrt(footprint.major**2 - radius**2)  # each tap is as wide as radius along the axis, too
    plain = table.material._replace(correction=None)

    def tap(x: Scalar) -> Array:
        at = xi.at[:2].add(x * reach * footprint.axis)
        return inputs(plain, program.layout, Point(at, radius, footprint.height, alpha))

    mean = jnp.matmul(weights, jax.vmap(tap)(positions), precision="highest")
    if table.material.correction is None:
        return mean
    added = correction(table.material, program.layout, xi[2], safe_sqrt(footprint.major * radius))
    return mean.at[: table.material.texture.rows.shape[1]].add(added)


def gaussian_taps(n: int) -> tuple[Array, Array]:
    """Positions and weights of n taps of a Gaussian cut at ±2.3 standard deviations, scaled to variance 1 (n = 1: 0).

    The cut, and the taps' radius of 0.35 spacings, balance truncation, gaps between taps, and blur across the axis:
    with 16 taps the error stays below 2% of the texture's standard deviation up to an ellipse of 8 : 1.
    """
    positions = (jnp.arange(n, dtype=jnp.float32) + 0.5) / n * 4.6 - 2.3
    weights = jax.nn.softmax(-positions * positions / 2)
    return safe_div(positions, jnp.sqrt(product(weights, positions**2))[None].repeat(n)), weights


@partial(jax.jit, static_argnums=0)
def density(
    program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, samples: Samples, count: Array
) -> tuple:
    """τ and the trunk's features of samples."""
    width = table.material.decoder.trunk[-1].bias.shape[0]

    def tile(s: Samples) -> tuple[Array, Array]:
        def one(s: Samples) -> Array:
            xi, footprint = _sample(program, table, pieces, at, s)
            return _inputs(program, table, xi, footprint)

        sigma, features = net.trunk(table.material.decoder, jax.vmap(one)(s))
        return optical_depth(sigma, s.step), features

    return in_tiles(tile, count, (samples,), ((0, jnp.float32), (width, jnp.float32)))


@partial(jax.jit, static_argnums=0)
def baked_depths(
    program: StaticConfig, table: DeviceTables, pieces: Piece, at: Frame, samples: Samples, count: Array
) -> Array:
    """τ of samples, by the grid."""

    def tile(s: Samples) -> tuple[Array]:
        sigma = jax.vmap(lambda s: _baked(program, table, _sample(program, table, pieces, at, s)[0]))(s)
        return (optical_depth(sigma, s.step),)

    return in_tiles(tile, count, (samples,), ((0, jnp.float32),))[0]


def _baked(program: StaticConfig, table: DeviceTables, xi: Vec3) -> Scalar:
    assert program.baked is not None and table.baked is not None
    alpha = _alpha(program, table, xi)[jnp.array(program.maps, jnp.int32)]
    return sigma_at(program.layout, program.baked, table.baked, xi, alpha, table.material.origin)


@partial(jax.jit, static_argnums=0)
def density_at(program: StaticConfig, table: DeviceTables, xi: Array, radius: Array, count: Array) -> Array:
    """σ at given points with isotropic filter radius, or by the grid: for the shell's shadow on the surface underneath."""

    def tile(xi: Array, radius: Array) -> tuple[Array]:
        if program.baked is not None:
            return (jax.vmap(partial(_baked, program, table))(xi),)
        zero = jnp.zeros_like(radius)
        axis = jnp.zeros((radius.shape[0], 2), radius.dtype)
        x = jax.vmap(partial(_inputs, program, table))(xi, Footprint(radius, radius, axis, zero))
        return (net.trunk(table.material.decoder, x)[0],)

    return in_tiles(tile, count, (xi, radius), ((0, jnp.float32),))[0]


@jax.jit
def transport(
    table: DeviceTables, at: Frame, pieces: Piece, features: Array, where: Array, row: Array, light: Array, count: Array
) -> Array:
    """ρ(ω, ω′) of samples and lights, (S, L, 3).

    features: trunk features from `density`, and where: the samples' rows in them; row: the samples' intervals; light:
    (S, L, 3) world directions toward the lights.
    """
    decoder, lights = table.material.decoder, light.shape[1]

    def tile(where: Array, row: Array, light: Array) -> tuple[Array]:
        inverse, d = at.inverse[row], pieces.direction[row]
        shared = net.toward_viewer(decoder, features[where], jax.vmap(net.direction)(inverse, -d))
        one = lambda toward: net.head(decoder, shared, jax.vmap(net.direction)(inverse, toward))  # noqa: E731
        rho = jax.lax.map(one, light.swapaxes(0, 1))
        return (rho.swapaxes(0, 1).reshape(-1, lights * 3),)

    return in_tiles(tile, count, (where, row, light), ((lights * 3, jnp.float32),))[0].reshape(-1, lights, 3)
