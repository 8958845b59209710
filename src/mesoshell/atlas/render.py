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

from mesoshell.atlas.field import Field, FieldConfig, density, radiance, to_texture
from mesoshell.atlas.layout import Layout, lookup
from mesoshell.atlas.march import CELLS, places, widened
from mesoshell.atlas.photo import Photo, photo_rays, pixel_centres
from mesoshell.nets.batches import pad
from mesoshell.numerics import opacity, optical_depth
from mesoshell.render.quality import Quality
from mesoshell.typing import Array, Bool, Float

TILE, CHUNK, ASKED = 1024, 8, 3


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


def picture(
    config: FieldConfig,
    field: Field,
    photo: Photo,
    quality: Quality,
    occupied: Bool[Array, "n n n"],
    paint: tuple[Layout, NumPyFloat[np.ndarray, "h w 6"]] | None = None,
) -> Picture:
    """What a camera in the box's units sees, one ray a pixel; with `paint`, of an edited texture."""
    o, d = photo_rays(photo, pixel_centres(photo))
    rows = -(-len(o) // TILE) * TILE
    tiles = [jnp.asarray(pad(x.astype(np.float32), rows)).reshape(-1, TILE, 3) for x in (o, d)]
    layout, image = (None, None) if paint is None else (paint[0], jnp.asarray(paint[1], jnp.float32))
    samples = -(-quality.samples // CHUNK) * CHUNK
    found = _tiles(config, layout, samples, field, occupied, image, jnp.float32(quality.early_stop), *tiles)
    rgb, passed, depth = (np.asarray(x).reshape(rows, -1)[: len(o)] for x in found)
    size = photo.height, photo.width
    rgba = np.concatenate([np.maximum(rgb, 0), 1 - passed], axis=1)
    return Picture(rgba.reshape(*size, 4), depth.reshape(size))


@partial(jax.jit, static_argnums=(0, 1, 2))
def _tiles(config, layout, samples, field, occupied, image, stop, o, d):
    def tile(rays):
        return _tile(config, layout, samples, field, occupied, image, stop, *rays)

    return jax.lax.map(tile, (o, d))


def _tile(config, layout, samples, field, occupied, image, stop, o, d):
    """(colour, transmittance, depth) of TILE rays, a few samples of all of them at a time."""
    t, step = jax.vmap(lambda o, d: places(o, d, occupied, jnp.full(samples, 0.5, o.dtype)))(o, d)

    def seen(y, d):
        sigma, features = density(config, field, y)
        c = radiance(config, field, y, d, features)
        if layout is not None:
            both = lookup(layout, image, to_texture(field, y))
            c = both[:3] + both[3:] * c
        return sigma, c

    def more(state):
        k, _, depth, _ = state
        return (k < samples // CHUNK) & (jnp.exp(-jnp.min(depth)) > stop)

    def chunk(state):
        k, colour, through, far = state
        here = jax.lax.dynamic_slice_in_dim(t, k * CHUNK, CHUNK, axis=1)
        y = o[:, None] + here[..., None] * d[:, None]
        sigma, c = jax.vmap(lambda y, d: jax.vmap(lambda y: seen(y, d))(y))(y, d)
        tau = optical_depth(sigma, jnp.broadcast_to(step[:, None], sigma.shape))
        after = through[:, None] + jnp.cumsum(tau, axis=1)
        w = jnp.exp(tau - after) * opacity(tau)
        return k + 1, colour + jnp.einsum("rk,rkc->rc", w, c), after[:, -1], far + jnp.sum(w * here, axis=1)

    zero = jnp.zeros(TILE, o.dtype)
    # rays without samples wait for nothing
    begin = jnp.where(step > 0, zero, jnp.inf)
    _, colour, through, far = jax.lax.while_loop(more, chunk, (0, jnp.zeros((TILE, 3), o.dtype), begin, zero))
    return colour, jnp.where(step > 0, jnp.exp(-through), 1.0), far
