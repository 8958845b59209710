"""An image of diffuse albedo over texture coordinates, for what nothing grows on (no JAX).

Notation
u, v        texture coordinates; an image's first row lies at v = 1, and the image repeats
width       of a footprint, in texture coordinates: the level is read whose texels are as wide
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from mesoshell.geometry.colour import LINEAR, Colour

#: Most texels a side: larger images are made smaller.
MOST = 2048


@dataclass(frozen=True, eq=False)
class Texture:
    """An image in sRGB and a factor, by which its linear colours are multiplied."""

    codes: UInt8[np.ndarray, "H W 3"]
    factor: Colour = field(default=(1.0, 1.0, 1.0))

    @cached_property
    def image(self) -> Float[np.ndarray, "H W 3"]:
        """Linear albedo, in [0, 1]."""
        return np.minimum(LINEAR.astype(np.float32)[self.codes] * np.array(self.factor, np.float32), 1)

    @cached_property
    def levels(self) -> list[Float[np.ndarray, "_h _w 3"]]:
        """The image, and ever smaller means of it, of half as many texels a side."""
        levels = [self.image]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_halved(levels[-1]))
        return levels

    def at(self, uv: Float[np.ndarray, "N 2"], width: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """Albedo at some places: bilinear in the nearest level."""
        side = max(self.image.shape[:2])
        widest = np.clip(np.nan_to_num(width, nan=1.0), 1 / side, 1)
        level = np.log2(widest * side).round().astype(int)
        level = np.minimum(level, len(self.levels) - 1)
        out = np.empty((len(uv), 3))
        for k in np.unique(level):
            own = level == k
            out[own] = _bilinear(self.levels[k], uv[own])
        return out


def texture_of(image: Any, factor: Colour = (1.0, 1.0, 1.0)) -> Texture:
    """Of a PIL image in sRGB."""
    if image.mode.startswith("I"):  # 16 bits of grey, of which PIL would keep the lower eight
        image = image.point(lambda v: v / 256).convert("L")
    image = image.convert("RGB")
    image.thumbnail((MOST, MOST))
    codes = np.array(image)
    codes.setflags(write=False)
    return Texture(codes, factor)


def _halved(image: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "_h _w 3"]:
    """Means of 2 × 2 texels; of an odd side, the last one stands twice."""
    h, w = image.shape[:2]
    padded = np.pad(image, ((0, h % 2 if h > 1 else 0), (0, w % 2 if w > 1 else 0), (0, 0)), mode="edge")
    rows = padded if h == 1 else (padded[0::2] + padded[1::2]) / 2
    return rows if w == 1 else (rows[:, 0::2] + rows[:, 1::2]) / 2


def _bilinear(image: Float[np.ndarray, "H W 3"], uv: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
    h, w = image.shape[:2]
    at = np.stack([1 - uv[:, 1], uv[:, 0]], axis=1)
    at = (at - np.floor(at)) * [h, w] - 0.5
    low = np.floor(at).astype(int)
    (y, x), (t, s) = low.T, (at - low).T[..., None]
    y0, y1, x0, x1 = y % h, (y + 1) % h, x % w, (x + 1) % w
    return (1 - t) * ((1 - s) * image[y0, x0] + s * image[y0, x1]) + t * ((1 - s) * image[y1, x0] + s * image[y1, x1])
