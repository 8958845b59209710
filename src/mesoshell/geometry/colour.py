"""The diffuse colour of a file's material: one colour, and of an image its mean (no JAX).

Notation
colour      linear Rec. 709, each from 0 to 1
"""

import io
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

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
        numbers = numbers * _mean(image)
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


def _mean(image: Any) -> np.ndarray:
    if image.mode.startswith("I"):  # 16 bits of grey, of which PIL would keep the lower eight
        image = image.point(lambda v: v / 256).convert("L")
    opaque = image.convert("RGBA").getchannel("A").point(lambda a: 255 if a > 127 else 0)
    whole = np.array(image.convert("RGB").histogram(opaque if opaque.getbbox() else None), np.float64).reshape(3, 256)
    return whole @ LINEAR / whole.sum(axis=1)
