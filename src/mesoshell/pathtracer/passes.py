"""Pictures of a path a pixel, of which any number together is even; a sampler of Mitsuba's must know it from the start.

Notation
P           pixels, numbered row by row
k           number of the path in each of them
"""

import drjit as dr
import mitsuba as mi
import numpy as np
from jaxtyping import Float, Int

from mesoshell.pathtracer.sequence import Sequence, hashed


def render_pass(scene: mi.Scene, pixels: Int[np.ndarray, "P"], k: int) -> Float[np.ndarray, "P 4"]:
    """RGBA of these pixels by path k of each, for a scene with our integrator; all of its pixels unless its film's filter is a
    box. The last is 1 where the film has none."""
    sensor = scene.sensors()[0]
    film = sensor.film()
    width, height = (int(x) for x in film.crop_size())
    pixel = mi.UInt32(pixels.astype(np.uint32))
    draws = Sequence(hashed(pixel + 1), dr.opaque(mi.UInt32, k), mi.UInt32(0))
    place = mi.Point2f(pixel % width, pixel // width) + draws.next_2d()
    lens = draws.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    time = (
        sensor.shutter_open() + (draws.next_1d() if sensor.shutter_open_time() > 0 else 0) * sensor.shutter_open_time()
    )
    ray, weight = sensor.sample_ray_differential(time, 0.5, place / mi.Point2f(width, height), lens)
    light, valid, _ = scene.integrator().sample(scene, draws, ray)
    opaque = not mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
    rgba = [*(light * weight), dr.select(opaque | valid, mi.Float(1), 0)]
    if film.rfilter().is_box_filter():
        return np.array(mi.Vector4f(rgba)).T
    return _filtered(film, place + mi.Point2f(film.crop_offset()), rgba[: 3 if opaque else 4]).reshape(-1, 4)[pixels]


def _filtered(film: mi.Film, place: mi.Point2f, values: list[mi.Float]) -> Float[np.ndarray, "H W 4"]:
    """Values at these places of the film through its filter, over the sum of the filter's weights."""
    film.prepare([])
    block = film.create_block()
    block.put(place, [*values, mi.Float(1)])
    film.put_block(block)
    return as_rgba(film.develop())


def as_rgba(image: mi.TensorXf) -> Float[np.ndarray, "H W 4"]:
    """A film's picture, opaque if it has no alpha."""
    pixels = np.array(image)
    return pixels[..., :4] if pixels.shape[-1] > 3 else np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
