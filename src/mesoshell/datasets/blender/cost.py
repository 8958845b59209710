"""What accuracy costs in Blender: error and seconds of one sample at many numbers of light paths.

symbol  meaning
y       x / (1 + x) of radiance: what training sees, peak 1
error   PSNR of y over the pixels whose alpha in the reference exceeds 0.5
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from mesoshell.datasets.blender.process import Blender
from mesoshell.errors import InputError
from mesoshell.io.image import read_exr
from mesoshell.measure.image import psnr_masked

SPP = tuple(2**k for k in range(11))
REFERENCE = 4096
#: Seed of the reference: with the same seed, its first paths would be those that it is compared with.
_OTHER_SEED = 2023


class Cell(NamedTuple):
    """paths a pixel; psnr in dB; seconds of Blender for the image."""

    samples_per_pixel: int
    denoise: bool
    psnr: float
    seconds: float


def reference_image(blender: Blender, index: int, scratch: Path) -> tuple[Float32[np.ndarray, "H W 4"], float]:
    """The image at REFERENCE paths a pixel, with y for colour, and its seconds. An untimed render before it does the work that
    is slow only once."""
    _render(blender, index, scratch, 1, False)
    return _render(blender, index, scratch, REFERENCE, False, cycles_seed=_OTHER_SEED)


def measure_cost(
    blender: Blender, index: int, scratch: Path, spp: int, denoise: bool, reference: Float32[np.ndarray, "H W 4"]
) -> Cell:
    """Error and seconds at `spp` paths. Raises InputError if the reference shows nothing."""
    mask = reference[..., 3] > 0.5
    if not mask.any():
        raise InputError(f"sample {index}", "shows nothing")
    image, seconds = _render(blender, index, scratch, spp, denoise)
    return Cell(spp, denoise, psnr_masked(image[..., :3], reference[..., :3], mask), seconds)


def _render(
    blender: Blender, index: int, scratch: Path, spp: int, denoise: bool, **own: int
) -> tuple[Float32[np.ndarray, "H W 4"], float]:
    answer = blender.render(index, scratch / "image.exr", samples_per_pixel=spp, denoise=denoise, **own)
    if "fault" in answer:
        raise InputError(f"sample {index}", answer["fault"])
    image = np.maximum(read_exr(scratch / "image.exr"), 0.0)
    return np.concatenate([image[..., :3] / (1.0 + image[..., :3]), image[..., 3:]], axis=-1), answer["seconds"][
        "blender"
    ]
