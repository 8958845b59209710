"""The diffuse colour of a file's material: one colour, and of an image its mean (no JAX).

Notation
colour      linear Rec. 709, each from 0 to 1
"""

import io
from typing import Any

import numpy as np

Colour = tuple[float, float, float]
#: Pixels along a side of what an image is shrunk to, before it is made linear.
SIDE = 64


def colour_of(factor: Any, image: Any = None) -> Colour | None:
    """A factor of at least three numbers times the mean of a PIL image in sRGB; None for what is no colour."""
    numbers = np.array(factor, np.float64).ravel()[:3]
    if len(numbers) < 3 or not np.isfinite(numbers).all():
        return None
    if image is not None:
        v = np.asarray(image.convert("RGB").resize((SIDE, SIDE), resample=4), np.float64) / 255  # 4: means of boxes
        linear = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
        numbers = numbers * linear.mean(axis=(0, 1))
    r, g, b = np.clip(numbers, 0, 1).tolist()
    return r, g, b


def image_of(data: bytes) -> Any:
    """A PIL image of a file's bytes; None if it is none, or too large."""
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data))
        image.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    return image
