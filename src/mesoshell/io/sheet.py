"""A contact sheet: many images of a dataset side by side (NumPy and scikit-image only).

Sorted by a parameter, it shows at a glance what the parameter does; by radius, whether every scale is there.
"""

import math

import numpy as np
from jaxtyping import Float32
from skimage.util import montage

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, Sample
from mesoshell.io.dataset_images import load_images
from mesoshell.io.image import tonemap

#: Linear grey between the images and behind their transparent parts; pixels between them.
_GREY, _GAP = 0.05, 2


def contact_sheet(
    dataset: Dataset, sort: str | None = None, count: int = 96, columns: int = 12
) -> Float32[np.ndarray, "H W 3"]:
    """`count` samples, evenly spaced in the order of `sort` (a parameter or "radius"; by index if None), row by row.

    Radiance is shown as x / (1 + x). Raises InputError if the dataset has no `sort`, or is empty.
    """
    ordered = sorted(dataset.samples, key=_key(dataset, sort))
    if not ordered:
        raise InputError(dataset.folder, "has no samples")
    some = [ordered[i] for i in np.linspace(0, len(ordered) - 1, min(count, len(ordered))).round().astype(int)]
    images = load_images(Dataset(dataset.folder, dataset.recipe, dataset.manifest, tuple(some)))
    return tile_pictures(over_grey(images), columns)


def over_grey(image: Float32[np.ndarray, "*N H W 4"]) -> Float32[np.ndarray, "*N H W 3"]:
    """Premultiplied linear RGBA as x / (1 + x) over grey."""
    return tonemap(np.maximum(image[..., :3], 0)) + np.float32(_GREY) * (1 - image[..., 3:])


def tile_pictures(y: Float32[np.ndarray, "N H W 3"], columns: int) -> Float32[np.ndarray, "h w 3"]:
    """Pictures row by row, `columns` per row, with a gap around each."""
    columns = min(columns, len(y))
    grid = math.ceil(len(y) / columns), columns
    return montage(y, fill=[_GREY] * 3, grid_shape=grid, padding_width=_GAP, channel_axis=-1)


def _key(dataset: Dataset, sort: str | None):
    if sort is None:
        return lambda sample: sample.index
    if sort == "radius":
        return lambda sample: sample.radius
    names = list(dataset.manifest["parameters"])
    if sort not in names:
        raise InputError(dataset.folder, f"cannot be sorted by '{sort}'; there are: {', '.join([*names, 'radius'])}")

    def value(sample: Sample) -> float:
        return sample.parameters[sort]

    return value
