"""Two pictures of one view as one: a wipe between them, or a map of where they differ."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from mesoshell.io.image import srgb_to_linear
from mesoshell.measure.flip import flip_map
from mesoshell.scene.accumulate import over_backdrop

#: Colour of the line between two pictures, linear.
_LINE = 1.0


class Difference(NamedTuple):
    """image: FLIP of each pixel as a colour, black where there is none, linear; flip: its mean."""

    image: Float[np.ndarray, "H W 3"]
    flip: float


def wipe(
    left: Float[np.ndarray, "H W 4"], right: Float[np.ndarray, "h w 4"], share: float
) -> Float[np.ndarray, "_ _ 3"]:
    """Columns of the left picture up to a share of the width, then those of the right one, and a line between; over white.
    A picture with fewer pixels is shown with as many as the other."""
    height, width = max(left.shape, right.shape)[:2]
    a, b = (_enlarged(over_white(x), width, height) for x in (left, right))
    column = min(round(share * width), width)
    image = np.concatenate([a[:, :column], b[:, column:]], axis=1)
    if 0 < column < width:
        image[:, column] = _LINE
    return image


def difference(a: Float[np.ndarray, "H W 4"], b: Float[np.ndarray, "H W 4"]) -> Difference:
    """Where two pictures of one size differ."""
    from matplotlib import colormaps

    flip = flip_map(over_backdrop(a), over_backdrop(b))
    return Difference(srgb_to_linear(colormaps["magma"](flip)[..., :3]), float(flip.mean()))


def over_white(rgba: Float[np.ndarray, "H W 4"]) -> Float[np.ndarray, "H W 3"]:
    """What a browser shows."""
    return rgba[..., :3] + 1 - rgba[..., 3:]


def _enlarged(image: Float[np.ndarray, "H W 3"], width: int, height: int) -> Float[np.ndarray, "h w 3"]:
    if image.shape[:2] == (height, width):
        return image
    planes = (Image.fromarray(plane.astype(np.float32)) for plane in np.moveaxis(image, -1, 0))
    return np.stack([np.asarray(p.resize((width, height), Image.Resampling.BILINEAR)) for p in planes], axis=-1)
