"""Render the unit box from features, as the discriminator sees it in a training step.

Notation
S, N         side of the picture in pixels; samples a ray
o, d         ray origin and unit direction; world and canonical frame are the same in the unit box (J = 1)
t0, t1       where a ray enters and leaves the box; t1 = t0 if it misses
y            2x/(1 + x) − 1 of the radiance x over black                        (S, S, 3)

A pixel is computed as in the renderer: samples, equally spaced here, each filtered by its piece of the pixel's cone, decoded,
depths summed, composited. A flat box needs no march: `box_span` is tested against the shell's boundary.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.numerics import normalise, optical_depth, product
from mesoshell.render.camera import pixel_radius
from mesoshell.render.composite import tonemap, weights
from mesoshell.render.cone import cone_gaussian
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material, Point
from mesoshell.shell.material.triplane import pack_planes
from mesoshell.texture import mip
from mesoshell.texture.footprint import footprint
from mesoshell.typing import Array, Float, Scalar, Vec3

#: Samples a tile of the network: on a CPU, 4096 take two thirds of the time of 1024.
_TILE = 4096


@dataclass(frozen=True)
class PictureConfig:
    """size: S; samples: N; fov: of the camera, radians; texels a patch; rows of the height feature; octaves of the decoder's
    height encoding; filtering: mip levels by the cone, or always the finest (an ablation); planes: as the generator's."""

    size: int = 64
    samples: int = 32
    fov: float = 0.4
    texels: int = 64
    height_rows: int = 64
    octaves: int = 4
    filtering: bool = True
    planes: Literal[1, 3] = 1

    @property
    def layout(self) -> Layout:
        levels = self.texels.bit_length() if self.filtering else 1
        sizes = tuple((self.texels >> i, self.texels >> i) for i in range(levels))
        cells = (1, 1) if self.planes > 1 else None
        heights = mip.level_sizes(self.height_rows, 1)[: None if self.filtering else 1]
        return Layout(sizes, heights, float(self.texels), self.octaves, open=True, cells=cells)


class View(NamedTuple):
    """One picture's camera, light and appearance parameters."""

    camera_to_world: Float[Array, "4 4"]
    light: Vec3
    irradiance: Vec3
    alpha: Float[Array, "A"]


def material_of(config: PictureConfig, feature: Array, height: Array, decoder: Decoder) -> Material:
    """Pyramids of one texture (V, U, C), or of three planes side by side in its channels, and of one height feature (R, C).

    Without filtering they are their finest level.
    """
    if config.planes > 1:
        texture = pack_planes(feature, config.layout.sizes)
    else:
        texture = mip.pack(mip.build_open(feature, len(config.layout.sizes) - 1))
    heights = mip.build(height[:, None])[: len(config.layout.height_sizes)]
    return Material(texture, mip.pack(heights), decoder)


def take_picture(
    config: PictureConfig,
    decoder: Decoder,
    see: Callable[[Point], Float[Array, "I"]],
    view: View,
    jitter: Float[Array, "#R N"],
) -> Float[Array, "S S 4"]:
    """Radiance over black, and alpha. see: the decoder's inputs at a point; jitter: where in its segment of the ray each sample
    lies, in [0, 1), a row for each pixel or one for all."""
    origin, directions = pixel_rays(config, view.camera_to_world)
    radius = jnp.asarray(pixel_radius(2 * math.tan(config.fov / 2) / config.size), directions.dtype)
    rays = config.size**2
    size = rays_a_tile(rays, config.samples)
    missed = jax.vmap(lambda d: jnp.diff(jnp.stack(box_span(origin, d)))[0] <= 0)(directions)
    order = jnp.argsort(missed)  # rays that hit come first: whole tiles of misses are skipped
    jitter = jnp.broadcast_to(jitter, (rays, config.samples))

    def tile(d: Array, j: Array) -> Array:
        points, length = jax.vmap(lambda d, j: along(config, origin, d, radius, j))(d, j)
        point = jax.tree.map(lambda x: x.reshape(size * config.samples, *x.shape[2:]), points)
        point = point._replace(alpha=jnp.broadcast_to(view.alpha[None], (len(point.radius), len(view.alpha))))
        sigma, features = net.trunk(decoder, jax.vmap(see)(point))
        toward = jnp.repeat(-d, config.samples, axis=0)
        light = jnp.broadcast_to(view.light[None], toward.shape)
        rho = net.head(decoder, net.toward_viewer(decoder, features, toward), light)
        tau = optical_depth(sigma.reshape(j.shape), jnp.broadcast_to(length[:, None], j.shape))
        share, through = jax.vmap(weights)(tau)
        reflected = jnp.einsum("rn,rnc->rc", share, rho.reshape(*j.shape, 3), precision="highest")
        return jnp.concatenate([reflected * view.irradiance[None], 1 - through[:, None]], axis=1)

    def unless_missed(part: tuple[Array, Array, Array]) -> Array:
        d, j, missed = part
        nothing = jnp.zeros((size, 4), directions.dtype)
        return jax.lax.cond(missed.all(), lambda d, j: nothing, jax.checkpoint(tile), d, j)

    rows = (directions[order], jitter[order], missed[order])
    parts = jax.tree.map(lambda x: x.reshape(rays // size, size, *x.shape[1:]), rows)
    rgba = jax.lax.map(unless_missed, parts).reshape(rays, 4)
    return jnp.zeros_like(rgba).at[order].set(rgba, unique_indices=True).reshape(config.size, config.size, 4)


def rays_a_tile(rays: int, samples: int) -> int:
    """Most rays whose samples fit into a tile, of those that divide `rays`."""
    return max(n for n in range(1, max(1, _TILE // samples) + 1) if rays % n == 0)


def discriminator_range(radiance: Float[Array, "*b S S 3"]) -> Float[Array, "*b S S 3"]:
    """y of radiance over black."""
    return 2 * tonemap(radiance) - 1


def pixel_rays(config: PictureConfig, camera_to_world: Float[Array, "4 4"]) -> tuple[Vec3, Float[Array, "R 3"]]:
    """The camera's place, and unit directions through the pixels' centres, row by row from the top."""
    half = math.tan(config.fov / 2)
    at = ((jnp.arange(config.size, dtype=camera_to_world.dtype) + 0.5) / config.size * 2 - 1) * half
    x, y = jnp.meshgrid(at, -at, indexing="xy")
    local = jnp.stack([x, y, -jnp.ones_like(x)], axis=-1).reshape(-1, 3)
    return camera_to_world[:3, 3], normalise(product(local, camera_to_world[:3, :3].T))


def box_span(o: Vec3, d: Vec3) -> tuple[Scalar, Scalar]:
    """t0 ≤ t1 of the unit box, both 0 if the ray misses it or is not finite. A ray in the plane of a side hits the box."""
    usable = jnp.isfinite(o).all() & jnp.isfinite(d).all()
    o, d = jnp.where(usable, o, 0.0), jnp.where(usable, d, 0.0)
    parallel = jnp.abs(d) < 1e-12
    safe = jnp.where(parallel, 1.0, d)
    low, high = -o / safe, (1 - o) / safe
    inside = (o >= 0) & (o <= 1)
    near = jnp.where(parallel, jnp.where(inside, -jnp.inf, jnp.inf), jnp.minimum(low, high))
    far = jnp.where(parallel, jnp.where(inside, jnp.inf, -jnp.inf), jnp.maximum(low, high))
    t0, t1 = jnp.maximum(jnp.max(near), 0.0), jnp.min(far)
    hit = usable & (t1 > t0) & jnp.isfinite(t1)
    return jnp.where(hit, t0, 0.0), jnp.where(hit, t1, 0.0)


def along(config: PictureConfig, o: Vec3, d: Vec3, radius: Scalar, jitter: Float[Array, "N"]) -> tuple[Point, Scalar]:
    """Samples of one ray (with no α yet), and the length that each stands for."""
    t0, t1 = box_span(o, d)
    length = (t1 - t0) / config.samples
    t = t0 + length * (jnp.arange(config.samples, dtype=d.dtype) + jitter)
    g = jax.vmap(cone_gaussian, in_axes=(0, None, None))(t, length / 2, radius)
    f = jax.vmap(footprint, in_axes=(None, None, 0, 0))(jnp.eye(3, dtype=d.dtype), d, g.along, g.across)
    keep = jnp.asarray(config.filtering, d.dtype)
    xi = jnp.clip(o[None] + t[:, None] * d[None], 0, 1)
    return Point(xi, f.minor * keep, f.height * keep, jnp.zeros((config.samples, 0), d.dtype)), length
