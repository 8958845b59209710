"""Pictures of a captured object.

Notation
samples     of a ray: `Quality.samples`, in whole CHUNKs, at the middles of equal parts; `Quality.pixel_samples` rays a pixel
occupied    cells where σ reaches Quality.skip over the box's diagonal at one of PROBES³ points in each, with their neighbours:
            no sample lies elsewhere, and a ray loses at most `skip` of optical depth, by these points
early_stop  samples are taken CHUNK at a time, until no ray of a tile has more than this transmittance
tile        TILE rays that meet an occupied cell; others are not marched
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float as NumPyFloat

from mesoshell.nets.batches import run
from mesoshell.nets.mlp import in_tiles
from mesoshell.neutex.brdf import shade
from mesoshell.neutex.cameras import Photo, photo_rays, pixels
from mesoshell.neutex.field import Field, FieldConfig, density, lobes, normal, radiance, to_texture
from mesoshell.neutex.layout import Layout, lookup
from mesoshell.neutex.march import CELLS, dilate, flash_radiance, places
from mesoshell.numerics import opacity, optical_depth
from mesoshell.render.camera import centred
from mesoshell.render.light import Distant, Environment, beams
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import draws_at
from mesoshell.typing import Array, Bool, Float, Scalar

TILE, CHUNK, PROBES = 1024, 8, 3
#: Offset of shadow rays along a surface's normal, in the box's units: past the fog that represents the surface.
AWAY = 0.06


class Picture(NamedTuple):
    """rgba: linear, premultiplied; depth: Σ w t, in the box's units."""

    rgba: NumPyFloat[np.ndarray, "h w 4"]
    depth: NumPyFloat[np.ndarray, "h w"]


class Paint(NamedTuple):
    """An edit: c′ = a(u) + s(u) c, with a and s side by side (neutex/edit)."""

    layout: Layout
    image: NumPyFloat[np.ndarray, "h w 6"]


class Lighting(NamedTuple):
    """Light on an object of reflectance, in the world's axes; without it the camera's flash is used."""

    lights: tuple[Distant, ...]
    sky: Environment | None


class View(NamedTuple):
    """How to render an object: quality, occupied cells (`occupancy`), edit and light."""

    quality: Quality
    occupied: Bool[Array, "n n n"]
    paint: Paint | None = None
    lit: Lighting | None = None


class StaticConfig(NamedTuple):
    """Static configuration. shown: colours too, or transmittance and depth alone; layout: of the edit, if there is one."""

    config: FieldConfig
    samples: int
    layout: Layout | None
    shown: bool


class FieldArrays(NamedTuple):
    """Arrays that all rays share; image: the edit's."""

    field: Field
    occupied: Bool[Array, "n n n"]
    stop: Scalar
    image: Float[Array, "h w 6"] | None


def view(
    config: FieldConfig, field: Field, quality: Quality, paint: Paint | None = None, lit: Lighting | None = None
) -> View:
    """Prepare an object for rendering from any camera."""
    return View(quality, occupancy(config, field, quality.skip), paint, lit)


def occupancy(config: FieldConfig, field: Field, skip: float) -> Bool[Array, "n n n"]:
    """Cells that rays take samples in; all of them if nothing may be skipped."""
    if not skip:
        return jnp.ones((CELLS,) * 3, bool)
    return dilate(_greatest(config, field) > skip / (2 * 3**0.5))


@partial(jax.jit, static_argnums=0)
def _greatest(config: FieldConfig, field: Field) -> Float[Array, "n n n"]:
    fine = CELLS * PROBES
    axis = (jnp.arange(fine, dtype=jnp.float32) + 0.5) / fine * 2 - 1

    def plane(x: Array) -> Array:
        grid = jnp.stack(jnp.broadcast_arrays(x, axis[:, None], axis[None]), axis=-1).reshape(-1, 3)
        return jax.vmap(lambda y: density(config, field, y)[0])(grid).reshape(fine, fine)

    sigma = jax.lax.map(plane, axis)
    return sigma.reshape(CELLS, PROBES, CELLS, PROBES, CELLS, PROBES).max(axis=(1, 3, 5))


def picture(config: FieldConfig, field: Field, photo: Photo, how: View) -> Picture:
    """Render from a camera in the box's units. Each light other than the flash is attenuated on its way to the mean depth of a
    ray."""
    n = how.quality.pixel_samples
    means = np.zeros((photo.height * photo.width, 5))
    for k in range(n):
        means += march_pixels(config, field, photo, how, pixels(photo, n, k), centred(n, k)) / n
    size = photo.height, photo.width
    return Picture(means[:, :4].reshape(*size, 4), means[:, 4].reshape(size))


def march_pixels(
    config: FieldConfig,
    field: Field,
    photo: Photo,
    how: View,
    xy: NumPyFloat[np.ndarray, "R 2"],
    steps: float,
) -> NumPyFloat[np.ndarray, "R 5"]:
    """RGBA and depth of a ray through each image point. steps: place in the sequence that draws directions of light."""
    quality, paint = how.quality, how.paint
    o, d = (x.astype(np.float32) for x in photo_rays(photo, xy))
    form = StaticConfig(config, -(-quality.samples // CHUNK) * CHUNK, paint and paint.layout, True)
    arrays = FieldArrays(
        field, how.occupied, jnp.float32(quality.early_stop), paint and jnp.asarray(paint.image, jnp.float32)
    )
    if how.lit is None:
        rgb, passed, depth = _marched(form, arrays, o, d)
        return np.concatenate([np.maximum(rgb, 0), 1 - passed, depth], axis=1)
    hidden = form._replace(shown=False)
    none, passed, depth = _marched(hidden, arrays, o, d)
    seen = np.flatnonzero(passed < 1)  # light is traced for these alone
    o, d = o[seen], d[seen]
    y = o + d * (depth[seen] / np.maximum(1 - passed[seen], 1e-3))
    (n,) = run(lambda *rows: _normals(config, field, *rows), y)
    falling = beams(how.lit.lights, how.lit.sky, quality.environment_samples, draws_at(np.floor(xy[seen]), steps))
    toward = np.stack([beam.toward for beam in falling], axis=1).astype(np.float32)
    strength = [
        beam.strength * _marched(hidden, arrays, y + AWAY * n, toward[:, i])[1] for i, beam in enumerate(falling)
    ]
    rgb = none
    rgb[seen] = _marched(form, arrays, o, d, (toward, np.stack(strength, axis=1).astype(np.float32)))[0]
    return np.concatenate([np.maximum(rgb, 0), 1 - passed, depth], axis=1)


@partial(jax.jit, static_argnums=0)
def _normals(config: FieldConfig, field: Field, y, count):
    one = jax.vmap(lambda y: normal(field, y, density(config, field, y)[1]))
    return in_tiles(lambda y: (one(y),), count, (y,), ((3, y.dtype),))


def _marched(form: StaticConfig, arrays: FieldArrays, o, d, light=()):
    """(colour, transmittance, depth) of any number of rays. light: (toward, E⊥) of each ray's lights; none for the flash."""
    (meets,) = run(lambda *rays: (_meets(arrays.occupied, *rays),), o, d)
    some = np.flatnonzero(meets)
    found = run(lambda *rays: _tiles(form, arrays, *rays), *(x[some] for x in (o, d, *light)))
    results = np.zeros((len(o), 3), o.dtype), np.ones((len(o), 1), o.dtype), np.zeros((len(o), 1), o.dtype)
    for result, x in zip(results, found, strict=True):
        result[some] = x.reshape(len(some), result.shape[1])
    return results


@jax.jit
def _meets(occupied: Bool[Array, "n n n"], o, d, count):
    """Whether rays meet an occupied cell."""
    (step,) = in_tiles(
        jax.vmap(lambda o, d: (places(o, d, occupied, jnp.full(1, 0.5, o.dtype))[1],)), count, (o, d), ((0, o.dtype),)
    )
    return step > 0


@partial(jax.jit, static_argnums=0)
def _tiles(form: StaticConfig, arrays: FieldArrays, o, d, *given):
    """Of the first `count` rays, the last of `given`; before it their lights, if any."""
    *light, count = given
    rays = (o, d, *light)
    outputs = jnp.zeros((len(o), 3), o.dtype), jnp.ones(len(o), o.dtype), jnp.zeros(len(o), o.dtype)

    def body(i, out):
        o, d, *light = (jax.lax.dynamic_slice_in_dim(x, i * TILE, TILE) for x in rays)
        made = _tile(form, arrays, o, d, tuple(light) or None)
        return tuple(jax.lax.dynamic_update_slice_in_dim(x, y, i * TILE, 0) for x, y in zip(out, made, strict=True))

    return jax.lax.fori_loop(0, (count + TILE - 1) // TILE, body, outputs)


def _tile(form: StaticConfig, arrays: FieldArrays, o, d, light):
    """(colour, transmittance, depth) of TILE rays, a few samples of all of them at a time."""
    t, step = jax.vmap(lambda o, d: places(o, d, arrays.occupied, jnp.full(form.samples, 0.5, o.dtype)))(o, d)

    def more(state):
        k, _, depth, _ = state
        return (k < form.samples // CHUNK) & (jnp.exp(-jnp.min(depth)) > arrays.stop)

    def chunk(state):
        k, colour, through, far = state
        here = jax.lax.dynamic_slice_in_dim(t, k * CHUNK, CHUNK, axis=1)
        y = o[:, None] + here[..., None] * d[:, None]
        sigma, c = jax.vmap(lambda y, t, d, l: jax.vmap(lambda y, t: _shaded(form, arrays, y, t, d, l))(y, t))(
            y, here, d, light
        )
        tau = optical_depth(sigma, jnp.broadcast_to(step[:, None], sigma.shape))
        after = through[:, None] + jnp.cumsum(tau, axis=1)
        w = jnp.exp(tau - after) * opacity(tau)
        colour = colour + jnp.einsum("rk,rkc->rc", w, c, precision="highest")
        return k + 1, colour, after[:, -1], far + jnp.sum(w * here, axis=1)

    zero = jnp.zeros(TILE, o.dtype)
    # rays without samples end at once
    begin = jnp.where(step > 0, zero, jnp.inf)
    _, colour, through, far = jax.lax.while_loop(more, chunk, (0, jnp.zeros((TILE, 3), o.dtype), begin, zero))
    return colour, jnp.where(step > 0, jnp.exp(-through), 1.0), far


def _shaded(form: StaticConfig, arrays: FieldArrays, y, t, d, light):
    """σ and colour of a point at distance t."""
    config, field = form.config, arrays.field
    sigma, features = density(config, field, y)
    if not form.shown:
        return sigma, jnp.zeros(3, y.dtype)
    if config.colour != "reflectance":
        return sigma, _edited(form, arrays, radiance(config, field, y, d, features), y)
    made, n = lobes(config, field, to_texture(field, y)), normal(field, y, features)
    made = made._replace(albedo=_edited(form, arrays, made.albedo, y))
    if light is None:
        return sigma, flash_radiance(config, made, n, d, t)
    return sigma, jnp.sum(jax.vmap(lambda toward, strength: shade(made, n, -d, toward) * strength)(*light), axis=0)


def _edited(form: StaticConfig, arrays: FieldArrays, c, y):
    if form.layout is None or arrays.image is None:
        return c
    both = lookup(form.layout, arrays.image, to_texture(arrays.field, y))
    return both[:3] + both[3:] * c
