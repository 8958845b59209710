"""A dataset as memory-mapped arrays: OUT/manifest.json, samples.jsonl and shards/NNNN.npy (NumPy only).

symbol   meaning                                                       shape
shard    half-precision premultiplied linear RGBA, rows from the top   (n, H, W, 4)
k        pixels of the dataset whose mean is a packed pixel            a side

The dataset's pixel filter is a box one pixel wide, so a mean over k × k pixels is what a render of that size would be,
with k² times its light paths. Rows are the dataset's own, with `file` and `row` for the place in a shard and `sha256`
of the image's bytes there. The folder gets its name when it is complete.
"""

import hashlib
import io
import json
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32

from mesoshell.errors import Argument, InputError
from mesoshell.io.atomic import new_folder, replace_file
from mesoshell.io.dataset import Dataset
from mesoshell.io.dataset_images import load_image
from mesoshell.io.image import HALF_MAX

#: Bytes of a shard, at most.
_SHARD_BYTES = 2**26


def pack_dataset(dataset: Dataset, out: Path, size: int | None = None) -> int:
    """Write `out` and return the bytes of its images. Raises InputError if it exists or cannot be written, the size does
    not divide the images', or an image is unusable; then nothing is left."""
    width, height = dataset.samples[0].size
    size = width if size is None else size
    if size < 1 or width % size or height % (width // size):
        raise InputError(Argument("size"), f"{size} does not divide the images' {width} × {height} pixels")
    with new_folder(out) as folder:
        (folder / "shards").mkdir()
        return _write(dataset, folder, width // size)


def _write(dataset: Dataset, folder: Path, k: int) -> int:
    rows, samples = [], dataset.samples
    load_image(samples[0])  # before memory is allocated
    width, height = (side // k for side in samples[0].size)
    a_shard = max(1, _SHARD_BYTES // (width * height * 8))
    for number, start in enumerate(range(0, len(samples), a_shard)):
        some = samples[start : start + a_shard]
        name = f"shards/{number:04d}.npy"
        shard = np.empty((len(some), height, width, 4), np.float16)
        for i, sample in enumerate(some):
            shard[i] = image = _means(load_image(sample), k)
            place = {
                "file": name,
                "row": i,
                "sha256": hashlib.sha256(image.tobytes()).hexdigest(),
                "size": [width, height],
            }
            rows.append(json.dumps({**dataset.rows[sample.index], **place}) + "\n")
        replace_file(folder / name, _npy(shard))
    (folder / "samples.jsonl").write_text("".join(rows))
    manifest = {**dataset.manifest, "size": [width, height], "packed": "half", "mean_of": [k, k], "count": len(samples)}
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
    return len(samples) * width * height * 8


def _npy(array: np.ndarray) -> bytes:
    """Bytes of the array's NPY file. (numpy.save hides why a write failed; a memory map on a full disk kills the process.)"""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _means(image: Float32[np.ndarray, "H W 4"], k: int) -> Float16[np.ndarray, "h w 4"]:
    h, w = image.shape[0] // k, image.shape[1] // k
    return np.minimum(image.reshape(h, k, w, k, 4).mean(axis=(1, 3)), HALF_MAX).astype(np.float16)
