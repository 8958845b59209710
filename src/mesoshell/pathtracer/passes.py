"""Render pictures of a path a pixel, whose mean is even after any number of them; Mitsuba's samplers must know the number.

Notation
P           pixels, numbered row by row
k           number of the path in each of them
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from jaxtyping import Float, Int

from mesoshell.pathtracer.sobol import Sobol, hash_bits


def can_pass(film: mi.Film) -> bool:
    """Whether a film shows what `render_pass` gives: colours, and what lies within it alone."""
    return (
        not mi.has_flag(film.flags(), mi.FilmFlags.Special)
        and film.base_channels_count() > 2
        and not film.sample_border()
    )


def render_pass(scene: mi.Scene, pixels: Int[np.ndarray, "P"], k: int) -> Float[np.ndarray, "P 4"]:
    """RGBA of these pixels by path k of each, for a scene with our integrator; alpha is 1 if the film has none. All pixels are
    needed through a filter other than a box."""
    sensor = scene.sensors()[0]
    film = sensor.film()
    width, height = (int(x) for x in film.crop_size())
    pixel = mi.UInt32(pixels.astype(np.uint32))
    draws = Sobol(hash_bits(pixel + 1), dr.opaque(mi.UInt32, k), mi.UInt32(0))
    place = mi.Point2f(pixel % width, pixel // width) + draws.next_2d()
    lens = draws.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
    begin = sensor.shutter_open()  # no scene of ours moves
    ray, weight = sensor.sample_ray_differential(begin, 0.5, place / mi.Point2f(width, height), lens)
    integrator: Any = scene.integrator()
    light, valid, _ = integrator.sample(scene, draws, ray)
    opaque = not mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
    rgba = [*(light * weight), dr.select(opaque | valid, mi.Float(1), 0)]
    if film.rfilter().is_box_filter():
        return np.array(mi.Vector4f(rgba)).T
    assert len(pixels) == width * height
    return _filtered(film, place + mi.Point2f(film.crop_offset()), rgba[: 3 if opaque else 4]).reshape(-1, 4)[pixels]


def _filtered(film: mi.Film, place: mi.Point2f, values: list[mi.Float]) -> Float[np.ndarray, "H W 4"]:
    """Values at these places of the film through its filter, over the sum of the filter's weights."""
    film.prepare([])
    block: Any = film.create_block()
    block.put(place, [*values, mi.Float(1)])
    film.put_block(block)
    return as_rgba(film.develop())


def as_rgba(image: Any) -> Float[np.ndarray, "H W 4"]:
    """A film's picture, (H, W, C), of 1 to 4 channels, or more: grey if it has no colours, opaque if it has no alpha."""
    pixels = np.array(image)
    if pixels.shape[-1] < 3:
        pixels = np.concatenate([pixels[..., [0, 0, 0]], pixels[..., 1:]], axis=-1)
    return pixels[..., :4] if pixels.shape[-1] > 3 else np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
