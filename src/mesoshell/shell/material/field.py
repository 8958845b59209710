"""A material as a field in the shell: density first, then transport for each light (MesoGAN, section 4.2).

Notation
ξ           (u, v, h), u and v in patches                                    (3,), canonical
r, σ_h      standard deviations of the filter on the tangent plane, in patches, and along the height
s           radius of a circle as large as all that is averaged; r, unless taps along an ellipse are
δ(λ, h)     correction of features that are averaged at level λ (train/prefilter)                     (C,)
F           F(u, v) + F(h) + δ, each filtered                                 (C,)
α           appearance parameters, normalised                                 (A,)
σ, ρ        extinction and transport function
ω, ω′       toward the viewer, toward the light                               (3,), canonical

A `Field` is a pair of pure functions of one point, so that renderers and tests take any medium, not only neural ones.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from mesoshell.io.corner_tiles import Colours
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.corner_tiles import Origin, on_torus, tile_place
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.triplane import lookup_planes
from mesoshell.texture import mip
from mesoshell.texture.mip import Pyramid, Sizes
from mesoshell.typing import Array, Float, Scalar, Vec2, Vec3


@dataclass(frozen=True)
class Layout:
    """Static facts of a material in a compiled program: sizes of both pyramids, texels a patch, height octaves, whether the
    texture has edges or is one patch that wraps around, and how many cells there are along (v, u) if each has three planes of
    its own (shell/material/triplane) in place of one texture. nodes: how many there are along (v, u) if F(h) varies over the
    texture (shell/generator/nodes). period: patches along a side of a texture that wraps around; colours: of corner tiles
    (io/corner_tiles), if it is their torus."""

    sizes: Sizes
    height_sizes: Sizes
    texel_density: float
    octaves: int
    open: bool = False
    cells: tuple[int, int] | None = None
    nodes: tuple[int, int] | None = None
    period: int = 1
    colours: Colours | None = None

    def on_texture(self, uv: Vec2, origin: Origin | None = None) -> Vec2:
        """(u, v) on the texture, in the unit that it is looked up in: from its origin, or in its period."""
        if self.open:
            return uv if origin is None else uv - origin.astype(jnp.int32).astype(uv.dtype)
        uv = uv if self.colours is None else on_torus(self.colours, origin, uv)
        return uv if self.period == 1 else uv / self.period

    def plane(self, texture: Pyramid, uv: Vec2, level: Scalar, origin: Origin | None = None) -> Float[Array, "C"]:
        """Filtered F(u, v)."""
        if self.colours is None:
            density = self.texel_density if self.open else None
            return mip.lookup(texture, self.sizes, self.on_texture(uv, origin), level, density)
        tile = partial(tile_place, self.colours, origin)
        return mip.lookup(texture, self.sizes, uv, level, self.texel_density, tile=tile)


class Material(NamedTuple):
    """Arrays of a neural material: feature pyramid, height pyramid and decoder; correction: δ of every level of the texture, as
    many rows of each; origin: (u, v) at which a texture with edges begins, or the plane of corner tiles, in whole patches; 0 if
    None. It is no part of the layout: another seed of tiles compiles no other program."""

    texture: Pyramid
    height: Pyramid
    decoder: Decoder
    correction: Float[Array, "L B C"] | None = None
    origin: Origin | None = None


class Point(NamedTuple):
    """Where the field is evaluated: ξ, the filter there, and the appearance parameters. spread: s, r if None."""

    xi: Vec3
    radius: Scalar
    height_deviation: Scalar
    alpha: Float[Array, "A"]
    spread: Scalar | None = None


def spread_of(point: Point) -> Scalar:
    """s of a point."""
    return point.radius if point.spread is None else point.spread


class Field(NamedTuple):
    """density: Point → (σ, features). transport: (features, ω, ω′) → ρ."""

    density: Callable[[Point], tuple[Scalar, Float[Array, "W"]]]
    transport: Callable[[Float[Array, "W"], Vec3, Vec3], Vec3]


def inputs(material: Material, layout: Layout, point: Point) -> Float[Array, "I"]:
    """Decoder inputs at a point: filtered F(u, v) + F(h) + δ, encoded height, α."""
    encoded = net.encode_height(point.xi[2], layout.octaves)
    if layout.cells is not None:
        where = point.xi, point.radius, point.height_deviation
        return jnp.concatenate(
            [lookup_planes(material.texture, layout.sizes, layout.cells, *where), encoded, point.alpha]
        )
    level = mip.level_of(point.radius, layout.texel_density, len(layout.sizes) - 1)
    rows = float(layout.height_sizes[0][0])
    level_h = mip.level_of(point.height_deviation, rows, len(layout.height_sizes) - 1)
    plane = layout.plane(material.texture, point.xi[:2], level, material.origin)
    plane = plane + correction(material, layout, point.xi[2], spread_of(point))
    if layout.nodes is None:
        profile = mip.lookup_height(material.height, layout.height_sizes, point.xi[2], level_h)
    else:
        uv = layout.on_texture(point.xi[:2], material.origin)
        profile = _between_nodes(material.height, layout, layout.nodes, uv, (point.xi[2], level_h))
    return jnp.concatenate([plane + profile, encoded, point.alpha])


def correction(material: Material, layout: Layout, h: Scalar, spread: Scalar) -> Float[Array, "C"] | float:
    """δ at h and s; 0 if the material has none."""
    if material.correction is None:
        return 0.0
    levels, rows, channels = material.correction.shape
    assert levels == len(layout.sizes)
    level = mip.level_of(spread, layout.texel_density, levels - 1)
    return mip.lookup_height(Pyramid(material.correction.reshape(-1, channels)), ((rows, 1),) * levels, h, level)


def _between_nodes(
    pyramid: Pyramid, layout: Layout, nodes: tuple[int, int], uv: Vec2, at: tuple[Scalar, Scalar]
) -> Float[Array, "C"]:
    """F(h) at (u, v), from F(h) of the four nodes around it. at: h and level."""
    rows = sum(h for h, _ in layout.height_sizes)
    first = jnp.clip(jnp.floor(uv), 0, jnp.array(nodes[::-1], uv.dtype) - 2)
    fu, fv = jnp.clip(uv - first, 0, 1)
    u, v = first.astype(jnp.int32)
    corners = (((v + j) * nodes[1] + u + i) * rows for j in (0, 1) for i in (0, 1))
    heights = jnp.stack([mip.lookup_height(pyramid, layout.height_sizes, *at, first=row) for row in corners])
    share = jnp.stack([(1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu])
    return jnp.matmul(share, heights, precision="highest")


def neural_field(material: Material, layout: Layout) -> Field:
    """The field of a neural material."""

    def density(point: Point) -> tuple[Scalar, Float[Array, "W"]]:
        return net.trunk(material.decoder, inputs(material, layout, point))

    def transport(features: Float[Array, "W"], w: Vec3, w_light: Vec3) -> Vec3:
        return net.head(material.decoder, net.toward_viewer(material.decoder, features, w), w_light)

    return Field(density, transport)
