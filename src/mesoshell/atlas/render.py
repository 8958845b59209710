"""Pictures of a captured object.

Alphabet
Paint       what an edit makes of a colour: c′ = a(u) + s(u) c, both as one image (h, w, 6) of a layout (atlas/paint)
samples     of a ray: `Quality.samples`, at the middles of their parts
occupied    cells where σ reaches Quality.skip over the box's diagonal, asked at ASKED³ points in each, with their neighbours: a
            ray that sees none costs no network, and loses at most `skip` of optical depth, as far as those points show
early_stop  samples are taken CHUNK at a time, until no ray of a tile has more than this transmittance
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float as NumPyFloat

from mesoshell.atlas.field import Field, FieldConfig, density, lobes, normal, radiance, to_texture
from mesoshell.atlas.layout import Layout, lookup
from mesoshell.atlas.march import CELLS, places, widened
from mesoshell.atlas.photo import Photo, photo_rays, pixel_centres
from mesoshell.atlas.reflect import shade
from mesoshell.nets.batches import pad
from mesoshell.numerics import opacity, optical_depth
from mesoshell.render.light import Distant, Environment, beams
from mesoshell.render.quality import Quality
from mesoshell.typing import Array, Bool, Float

TILE, CHUNK, ASKED = 1024, 8, 3
#: How far from a surface a light's way begins, in the box's units: outside of the fog that the surface is.
AWAY = 0.06


class Picture(NamedTuple):
    """rgba: linear, premultiplied; depth: Σ w t, in the box's units."""

    rgba: NumPyFloat[np.ndarray, "h w 4"]
    depth: NumPyFloat[np.ndarray, "h w"]


def occupancy(config: FieldConfig, field: Field, skip: float) -> Bool[Array, "n n n"]:
    """Cells that rays take samples in; all of them if nothing may be skipped."""
    if not skip:
        return jnp.ones((CELLS,) * 3, bool)
    return widened(_greatest(config, field) > skip / (2 * 3**0.5))


@partial(jax.jit, static_argnums=0)
def _greatest(config: FieldConfig, field: Field) -> Float[Array, "n n n"]:
    fine = CELLS * ASKED
    axis = (jnp.arange(fine, dtype=jnp.float32) + 0.5) / fine * 2 - 1

    def plane(x: Array) -> Array:
        grid = jnp.stack(jnp.broadcast_arrays(x, axis[:, None], axis[None]), axis=-1).reshape(-1, 3)
        return jax.vmap(lambda y: density(config, field, y)[0])(grid).reshape(fine, fine)

    sigma = jax.lax.map(plane, axis)
    return sigma.reshape(CELLS, ASKED, CELLS, ASKED, CELLS, ASKED).max(axis=(1, 3, 5))


class Lit(NamedTuple):
    """Light on an object of reflectance, in the world's axes; without it the camera's flash goes on."""

    lights: tuple[Distant, ...]
    sky: Environment | None


def picture(
    config: FieldConfig,
    field: Field,
    photo: Photo,
    quality: Quality,
    occupied: Bool[Array, "n n n"],
    paint: tuple[Layout, NumPyFloat[np.ndarray, "h w 6"]] | None = None,
    lit: Lit | None = None,
) -> Picture:
    """What a camera in the box's units sees, one ray a pixel; with `paint`, of an edited texture; with `lit`, under other
    light: each is blocked by what it passes on its way to where the pixel's ray ends, on the mean."""
    o, d = (x.astype(np.float32) for x in photo_rays(photo, pixel_centres(photo)))
    layout, image = (None, None) if paint is None else (paint[0], jnp.asarray(paint[1], jnp.float32))
    samples = -(-quality.samples // CHUNK) * CHUNK
    march = partial(_in_tiles, config, layout, samples, field, occupied, image, quality.early_stop)
    if lit is None:
        rgb, passed, depth = march(o, d, None)
    else:
        _, passed, depth = march(o, d, None)
        y = o + d * (depth / np.maximum(1 - passed, 1e-3))
        falling = beams(lit.lights, lit.sky, quality.environment_samples, len(o), np.random.default_rng(0))
        strength = [
            b.strength * march((y + AWAY * b.toward).astype(np.float32), b.toward.astype(np.float32), None)[1]
            for b in falling
        ]
        rgb, passed, depth = march(o, d, (np.stack([b.toward for b in falling], 1), np.stack(strength, 1)))
    size = photo.height, photo.width
    rgba = np.concatenate([np.maximum(rgb, 0), 1 - passed], axis=1)
    return Picture(rgba.reshape(*size, 4), depth.reshape(size))


def _in_tiles(config, layout, samples, field, occupied, image, stop, o, d, light):
    """(colour, transmittance, depth) of any number of rays. light: (toward, E⊥) of each ray's lights, or the flash."""
    rows = -(-len(o) // TILE) * TILE

    def tiled(x):
        padded = pad(np.asarray(x, np.float32), rows)
        return jnp.asarray(padded.reshape(-1, TILE, *x.shape[1:]))

    found = _tiles(
        config,
        layout,
        samples,
        field,
        occupied,
        image,
        jnp.float32(stop),
        tiled(o),
        tiled(d),
        light and tuple(map(tiled, light)),
    )
    return tuple(np.asarray(x).reshape(rows, -1)[: len(o)] for x in found)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _tiles(config, layout, samples, field, occupied, image, stop, o, d, light):
    def tile(rays):
        return _tile(config, layout, samples, field, occupied, image, stop, *rays)

    return jax.lax.map(tile, (o, d, light))


def _tile(config, layout, samples, field, occupied, image, stop, o, d, light):
    """(colour, transmittance, depth) of TILE rays, a few samples of all of them at a time."""
    t, step = jax.vmap(lambda o, d: places(o, d, occupied, jnp.full(samples, 0.5, o.dtype)))(o, d)
    flash = config.colour == "reflectance" and light is None

    def edited(c, y):
        if layout is None:
            return c
        both = lookup(layout, image, to_texture(field, y))
        return both[:3] + both[3:] * c

    def seen(y, t, d, light):
        sigma, features = density(config, field, y)
        if config.colour != "reflectance":
            return sigma, edited(radiance(config, field, y, d, features), y)
        made = lobes(config, field, to_texture(field, y))
        made, n = made._replace(albedo=edited(made.albedo, y)), normal(field, y, features)
        if light is None:
            return sigma, shade(made, n, -d, -d) * (config.flash / jnp.maximum(t, 1e-3) ** 2)
        each = jax.vmap(lambda toward, strength: shade(made, n, -d, toward) * strength)(*light)
        return sigma, jnp.sum(each, axis=0)

    def more(state):
        k, _, depth, _ = state
        return (k < samples // CHUNK) & (jnp.exp(-jnp.min(depth)) > stop)

    def chunk(state):
        k, colour, through, far = state
        here = jax.lax.dynamic_slice_in_dim(t, k * CHUNK, CHUNK, axis=1)
        y = o[:, None] + here[..., None] * d[:, None]
        sigma, c = jax.vmap(lambda y, t, d, l: jax.vmap(lambda y, t: seen(y, t, d, l))(y, t))(y, here, d, light)
        tau = optical_depth(sigma, jnp.broadcast_to(step[:, None], sigma.shape))
        after = through[:, None] + jnp.cumsum(tau, axis=1)
        before = jnp.exp(tau - after)
        w = before * opacity(tau)
        shown = w * before if flash else w
        return k + 1, colour + jnp.einsum("rk,rkc->rc", shown, c), after[:, -1], far + jnp.sum(w * here, axis=1)

    zero = jnp.zeros(TILE, o.dtype)
    # rays without samples wait for nothing
    begin = jnp.where(step > 0, zero, jnp.inf)
    _, colour, through, far = jax.lax.while_loop(more, chunk, (0, jnp.zeros((TILE, 3), o.dtype), begin, zero))
    return colour, jnp.where(step > 0, jnp.exp(-through), 1.0), far
