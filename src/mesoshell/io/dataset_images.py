"""Images of a dataset: EXR files, or rows of a packed dataset's shards (NumPy only)."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file
from mesoshell.io.dataset import Dataset, Sample
from mesoshell.io.image import read_exr
from mesoshell.limits import check_memory


def load_image(sample: Sample) -> Float32[np.ndarray, "H W 4"]:
    """One image. Raises InputError that names its file if it is unreadable, mis-sized or holds NaN."""
    image = _pixels(sample).astype(np.float32)
    for fault in _pixel_faults(sample, image):
        raise InputError(sample.file, fault)
    return image


def load_images(dataset: Dataset) -> Float32[np.ndarray, "N H W 4"]:
    """All images, in the order of the samples. Raises InputError as load_image does."""
    width, height = dataset.samples[0].size
    load_image(dataset.samples[0])  # before memory is asked for
    check_memory(
        dataset.folder,
        f"{len(dataset.samples)} images of {width} × {height}",
        16 * len(dataset.samples) * width * height,
    )
    images = np.empty((len(dataset.samples), height, width, 4), np.float32)
    for row, sample in zip(images, dataset.samples, strict=True):
        row[:] = load_image(sample)
    return images


def image_faults(sample: Sample) -> list[str]:
    """Faults of a sample's file, each as a whole line."""
    faults = []
    where = str(sample.file) if sample.row is None else f"{sample.file}[{sample.row}]"
    try:
        bytes_of = read_file(sample.file) if sample.row is None else _pixels(sample).tobytes()
        if hashlib.sha256(bytes_of).hexdigest() != sample.sha256:
            faults.append(f"{where}: its SHA-256 is not its row's")
        image = _pixels(sample).astype(np.float32)
    except InputError as error:
        return [*faults, str(error)]
    black = [] if image[..., :3].any() else ["is all black"]
    return faults + [f"{where}: {fault}" for fault in _pixel_faults(sample, image) + black]


def _pixels(sample: Sample) -> np.ndarray:
    """The image as it lies on disk, (H, W, C), half or float."""
    if sample.row is None:
        return read_exr(sample.file)
    return shard_row(sample, shard_array(sample.file))


def shard_row(sample: Sample, shard: Float16[np.ndarray, "n H W C"]) -> Float16[np.ndarray, "H W C"]:
    """A packed sample's image in its shard. Raises InputError if it is not there."""
    if sample.row is None or sample.row >= len(shard):
        raise InputError(sample.file, f"has no row {sample.row}")
    return shard[sample.row]


def check_fed(samples: Sequence[Sample], shard: Float16[np.ndarray, "n H W C"]) -> None:
    """Raise InputError unless a shard holds images of its samples' size, four channels each, and not zeros alone."""
    shown = False
    for sample in samples:
        height, width, channels = shard_row(sample, shard).shape
        for fault in _shape_faults(sample, (height, width, channels)):
            raise InputError(sample.file, fault)
        shown = shown or bool(shard[sample.row].any())
    if not shown:
        raise InputError(samples[0].file, "holds zeros alone: no image")


def shard_array(path: Path) -> Float16[np.ndarray, "n H W C"]:
    """A shard of a packed dataset, memory-mapped. Raises InputError if it is not one."""
    try:
        array = np.load(path, mmap_mode="r")
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except Exception as error:  # ValueError, EOFError, TokenError, UnicodeDecodeError, … by the bad byte
        raise InputError(path, "not a NumPy array, or a truncated one") from error
    if not isinstance(array, np.ndarray):
        raise InputError(path, "an archive, not a NumPy array")
    if array.dtype != np.float16 or array.ndim != 4:
        raise InputError(path, f"holds {array.dtype} of shape {array.shape}; expected half images")
    return array


def _pixel_faults(sample: Sample, image: Float32[np.ndarray, "H W C"]) -> list[str]:
    faults = _shape_faults(sample, image.shape)
    if not np.isfinite(image).all():
        faults.append("has NaN or infinite pixels")
    return faults


def _shape_faults(sample: Sample, shape: tuple[int, ...]) -> list[str]:
    height, width, channels = shape
    faults = []
    if (width, height) != sample.size:
        faults.append(f"is {width} × {height} pixels; its row says {sample.size[0]} × {sample.size[1]}")
    if channels != 4:
        faults.append(f"has {channels} channels; expected 4 (RGBA)")
    return faults
