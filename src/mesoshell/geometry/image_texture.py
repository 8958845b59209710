"""An image of diffuse albedo over texture coordinates, for what nothing grows on (no JAX).

Notation
u, v        texture coordinates; an image's first row lies at v = 1, and the image repeats
width       of a footprint, in texture coordinates: the level is read whose texels are as wide
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from mesoshell.geometry.colour import LINEAR, Colour, opaque_rgb

#: Most texels a side: larger images are made smaller.
MOST = 2048
#: Rows of an image that are made smaller together.
TOGETHER = 256
#: A footprint in which every image is its mean.
WIDE = 2.0**20


@dataclass(frozen=True, eq=False)
class Texture:
    """An image in sRGB and a factor, by which its linear colours are multiplied."""

    codes: UInt8[np.ndarray, "H W 3"]
    factor: Colour = (1.0, 1.0, 1.0)

    def __getstate__(self) -> dict[str, Any]:
        return {"codes": self.codes, "factor": self.factor}  # without the levels

    @property
    def image(self) -> Float[np.ndarray, "H W 3"]:
        """Linear albedo, in [0, 1]."""
        return self._albedo(LINEAR.astype(np.float32)[self.codes])

    @cached_property
    def _smaller(self) -> list[Float[np.ndarray, "_h _w 3"]]:
        """Linear means of the codes, of half as many texels a side, and so on to one."""
        levels, last = [], LINEAR.astype(np.float32)[self.codes]
        while max(last.shape[:2]) > 1:
            last = _shrunk(_shrunk(last, -(-last.shape[0] // 2), 0), -(-last.shape[1] // 2), 1)
            levels.append(last)
        return levels

    def at(self, uv: Float[np.ndarray, "N 2"], width: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """Albedo at some places: bilinear in the nearest level."""
        texels = np.nan_to_num(width, nan=WIDE, posinf=WIDE).clip(0, WIDE) * np.sqrt(np.prod(self.codes.shape[:2]))
        level = np.log2(np.maximum(texels, 1)).round().astype(int)
        level = np.minimum(level, len(self._smaller))
        out = np.empty((len(uv), 3))
        for k in np.unique(level):
            own = level == k
            out[own] = _bilinear(self.codes if k == 0 else self._smaller[k - 1], uv[own])
        return self._albedo(out)

    def _albedo(self, linear: np.ndarray) -> np.ndarray:
        return np.minimum(linear * np.array(self.factor, linear.dtype), 1)


class Look(NamedTuple):
    """A material's diffuse colour; and the image whose mean it is. Nothing where its file says none that is understood."""

    colour: Colour | None = None
    texture: Texture | None = None


def codes_of(image: Any) -> UInt8[np.ndarray, "H W 3"]:
    """A PIL image in sRGB. What is not opaque has the mean of what is; MOST texels a side, at most."""
    codes, opaque = opaque_rgb(image)
    if opaque.any() and not opaque.all():
        codes[~opaque] = _encoded(LINEAR[codes[opaque]].mean(axis=0))
    h, w = codes.shape[:2]
    share = min(1, MOST / max(h, w))
    if share < 1:
        rows, columns = max(1, round(h * share)), max(1, round(w * share))
        parts = (LINEAR.astype(np.float32)[codes[k : k + TOGETHER]] for k in range(0, h, TOGETHER))
        narrow = np.concatenate([_shrunk(part, columns, 1) for part in parts])
        codes = _encoded(_shrunk(narrow, rows, 0))
    codes.setflags(write=False)
    return codes


def _encoded(linear: np.ndarray) -> UInt8[np.ndarray, "..."]:
    """The nearest codes in sRGB."""
    return np.searchsorted((LINEAR[1:] + LINEAR[:-1]) / 2, linear).astype(np.uint8)


def _shrunk(image: Float[np.ndarray, "H W 3"], count: int, axis: int) -> Float[np.ndarray, "_h _w 3"]:
    """Means over `count` equal parts of an axis, whose ends may lie within texels."""
    n = image.shape[axis]
    at = np.arange(count + 1) * n / count
    low = np.minimum(at.astype(int), n - 1)
    total = np.cumsum(image, axis=axis, dtype=np.float64)
    before = np.take(np.concatenate([np.zeros_like(np.take(total, [0], axis)), total], axis), low, axis)
    within = (at - low).reshape(-1, *(1,) * (2 - axis)) * np.take(image, low, axis)
    return (np.diff(before + within, axis=axis) * (count / n)).astype(np.float32)


def _bilinear(image: np.ndarray, uv: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
    """Linear colours of linear ones, or of codes."""
    h, w = image.shape[:2]
    at = np.stack([1 - uv[:, 1], uv[:, 0]], axis=1)
    at = (at - np.floor(at)) * [h, w] - 0.5
    low = np.floor(at).astype(int)
    (y, x), (t, s) = low.T, (at - low).T[..., None]
    y0, y1, x0, x1 = y % h, (y + 1) % h, x % w, (x + 1) % w
    corners = (image[y0, x0], image[y0, x1], image[y1, x0], image[y1, x1])
    a, b, c, d = (LINEAR[x] if image.dtype == np.uint8 else x for x in corners)
    return (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
