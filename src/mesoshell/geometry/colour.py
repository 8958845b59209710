"""The diffuse colour of a file's material: a number, or the mean of an image (no JAX).

Notation
colour      linear Rec. 709, each from 0 to 1
"""

import io
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, UInt8

Colour = tuple[float, float, float]
T = TypeVar("T")
#: Light of each value of 8 bits.
_V = np.arange(256) / 255
LINEAR = np.where(_V <= 0.04045, _V / 12.92, ((_V + 0.055) / 1.055) ** 2.4)


def colour_of(factor: Any, image: Any = None) -> Colour | None:
    """A factor of at least three numbers times the mean of a PIL image in sRGB, where it is opaque; None for what is no
    colour."""
    numbers = np.array(factor, np.float64).ravel()[:3]
    if len(numbers) < 3 or not np.isfinite(numbers).all():
        return None
    if image is not None:
        codes, opaque = opaque_rgb(image)
        seen = codes[opaque] if opaque.any() else codes.reshape(-1, 3)
        counts = np.stack([np.bincount(seen[:, k], minlength=256) for k in range(3)])
        numbers = numbers * (counts @ LINEAR) / len(seen)
    r, g, b = np.clip(numbers, 0, 1).tolist()
    return r, g, b


def read_or_none(read: Callable[[], T | None]) -> T | None:
    """What `read` gives, None where it fails: whatever is wrong with a colour or its image, which Pillow and OpenUSD say by
    exceptions of any kind, the mesh is read."""
    try:
        return read()
    except Exception:
        return None


def image_of(data: bytes) -> Any:
    """A PIL image of a file's bytes."""
    from PIL import Image

    return Image.open(io.BytesIO(data))


def opaque_rgb(image: Any) -> tuple[UInt8[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Values of a PIL image, and where it is opaque."""
    if image.mode.startswith("I"):  # 16 bits of grey, of which PIL would keep the lower eight
        grey = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2), np.ones(grey.shape, bool)
    rgba = np.array(image.convert("RGBA"))
    return np.ascontiguousarray(rgba[..., :3]), rgba[..., 3] > 127
