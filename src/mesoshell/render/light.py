"""Lights: distant ones, and an environment sampled by its brightness.

Notation
L           unit vector toward a light                                        (3,), world
E⊥          irradiance on the plane facing a distant light                     RGB
(θ, φ)      polar angle from the map's upper edge, azimuth; a latitude-longitude map with z (or y) up. As in Blender, its
            middle column lies toward +x, and columns to the right of it go clockwise, seen from above
p           density over solid angle of a drawn direction                      1/sr
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.render.sequence import Draws

#: Luminance of linear Rec. 709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class Distant(NamedTuple):
    """A distant light: unit direction toward it, and E⊥."""

    direction: Float[np.ndarray, "3"]
    irradiance: Float[np.ndarray, "3"]


class Environment(NamedTuple):
    """A latitude-longitude map (H, W, 3), its up axis (1: y, 2: z), and the cumulative distribution over its pixels."""

    radiance: Float[np.ndarray, "H W 3"]
    up: int
    cumulative: Float[np.ndarray, "N"]


def environment(radiance: Float[np.ndarray, "H W 3"], up: int) -> Environment:
    """Make a map ready for sampling in proportion to luminance times solid angle."""
    h = radiance.shape[0]
    area = np.sin((np.arange(h) + 0.5) / h * np.pi)[:, None]
    luminance = radiance @ LUMINANCE
    weight = (luminance + 1e-3 * luminance.mean() + 1e-12) * area
    cumulative = np.cumsum(weight.ravel())
    return Environment(np.asarray(radiance, np.float32), up, cumulative / cumulative[-1])


def lookup(e: Environment, d: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R 3"]:
    """Radiance from unit directions d: the nearest pixel of the map."""
    h, w = e.radiance.shape[:2]
    x, y, z = _local(d, e.up)
    row = np.clip((np.arccos(np.clip(z, -1, 1)) / np.pi * h).astype(int), 0, h - 1)
    column = ((0.5 - np.arctan2(y, x) / (2 * np.pi)) % 1.0 * w).astype(int) % w
    return e.radiance[row, column]


def sample(e: Environment, xi: Float[np.ndarray, "R 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Directions (R, 3) drawn by brightness, and radiance / p (R, 3). xi: three uniform numbers a direction."""
    h, w = e.radiance.shape[:2]
    pixel = np.minimum(np.searchsorted(e.cumulative, xi[:, 0], side="right"), h * w - 1)
    mass = e.cumulative[pixel] - np.where(pixel > 0, e.cumulative[pixel - 1], 0.0)
    row, column = pixel // w, pixel % w
    edges = np.cos(np.stack([row, row + 1]) / h * np.pi)  # uniform in the pixel's solid angle
    z = edges[0] + xi[:, 1] * (edges[1] - edges[0])
    phi = (0.5 - (column + xi[:, 2]) / w) * 2 * np.pi
    solid = (edges[0] - edges[1]) * 2 * np.pi / w
    s = np.sqrt(np.maximum(1 - z * z, 0))
    d = _world(np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1), e.up)
    return d, e.radiance[row, column] * (solid / mass)[:, None]


def _local(d: np.ndarray, up: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (d[:, 0], d[:, 1], d[:, 2]) if up == 2 else (d[:, 0], -d[:, 2], d[:, 1])


def _world(d: np.ndarray, up: int) -> np.ndarray:
    return d if up == 2 else np.stack([d[:, 0], d[:, 2], -d[:, 1]], axis=1)


class Beam(NamedTuple):
    """One light as every ray of a tile sees it: direction and E a ray."""

    toward: Float[np.ndarray, "R 3"]
    strength: Float[np.ndarray, "R 3"]


def beams(lights: tuple[Distant, ...], sky: Environment | None, drawn: int, draws: Draws) -> list[Beam]:
    """For rays, every distant light, and `drawn` directions of the environment, each as a light of its own."""
    shape = (len(draws.rotation), 3)
    out = [Beam(np.broadcast_to(l.direction, shape), np.broadcast_to(l.irradiance, shape)) for l in lights]
    if sky is not None:
        each = (sample(sky, xi) for xi in draws.triples(drawn))
        out += [Beam(toward, strength / drawn) for toward, strength in each]
    return out
