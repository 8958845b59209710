"""Batches of a packed dataset: shuffled, split over hosts, restartable at any step.

symbol    meaning                                                  shape, unit
B         samples a batch, on this host
step      batches taken so far; batch `step` does not depend on what was read before
α, β      parameters of appearance and geometry, each mapped to [0, 1] by its range

Pixels come from memory-mapped shards, so that a dataset may exceed the memory; all else is small and held in arrays. grain
orders them: every pass over the data is a new permutation from the seed, and a batch may straddle two passes. Hosts take equal
consecutive parts of each batch, in order: together they see the rows that one host would see.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import grain
import numpy as np
from jaxtyping import Float16, Float32, Int32, Integer

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, Sample, parameter_table
from mesoshell.io.dataset_images import check_fed, shard_array
from mesoshell.limits import allow_files

#: The images of a file.
Shard = Float16[np.ndarray, "n H W C"]


class Batch(NamedTuple):
    """B samples. image is premultiplied linear RGBA; index is the samples' own."""

    image: Float16[np.ndarray, "B H W 4"]
    alpha: Float32[np.ndarray, "B A"]
    beta: Float32[np.ndarray, "B G"]
    camera_to_world: Float32[np.ndarray, "B 4 4"]
    light: Float32[np.ndarray, "B 3"]
    irradiance: Float32[np.ndarray, "B 3"]
    index: Int32[np.ndarray, "B"]


class Feed:
    """An endless sequence of batches: `feed[step]`, or `feed.after(step)` to iterate with reading ahead."""

    def __init__(
        self,
        dataset: Dataset,
        batch: int,
        seed: int = 0,
        host: int = 0,
        hosts: int = 1,
        shards: Mapping[Path, Shard] | None = None,
    ):
        """shards: of `open_shards`, if several share them. Raises InputError if the dataset is not packed, or too small for a
        batch a host."""
        if not 0 <= host < hosts or batch < 1:
            raise ValueError(f"host {host} of {hosts}, batch {batch}")
        if len(dataset.samples) < hosts:
            raise InputError(dataset.folder, f"has {len(dataset.samples)} samples for {hosts} hosts")
        order = grain.MapDataset.range(len(dataset.samples)).seed(seed).shuffle().repeat()
        mine, table = slice(host * batch, (host + 1) * batch), _Table(dataset, shards)
        self._batches = order.batch(batch * hosts).map(lambda positions: table.take(positions[mine]))

    def __getitem__(self, step: int) -> Batch:
        return cast(Batch, self._batches[step])

    def after(self, step: int, ahead: int = 4) -> Iterator[Batch]:
        """Batches from `step` on, up to `ahead` of them read in advance."""
        options = grain.ReadOptions(num_threads=min(ahead, 4), prefetch_buffer_size=ahead)
        iterator = iter(self._batches.to_iter_dataset(options))
        iterator.set_state({"next_index": step})
        return iterator


def open_shards(dataset: Dataset) -> dict[Path, Shard]:
    """The arrays of a packed dataset, mapped, by their files. Raises InputError if it is not packed, or one is damaged."""
    if any(sample.row is None for sample in dataset.samples):
        raise InputError(dataset.folder, "is not packed; pack it with: mesoshell dataset pack")
    by_file: dict[Path, list[Sample]] = {}
    for sample in dataset.samples:
        by_file.setdefault(sample.file, []).append(sample)
    allow_files(len(by_file))
    shards = {file: shard_array(file) for file in by_file}
    for file, samples in by_file.items():
        check_fed(samples, shards[file])
    return shards


class _Table:
    """Samples by position: small columns in memory, images in their shards."""

    def __init__(self, dataset: Dataset, shards: Mapping[Path, Shard] | None = None):
        samples = dataset.samples
        shards = open_shards(dataset) if shards is None else shards
        self._images = [shards[sample.file][sample.row] for sample in samples]
        self._files = [sample.file for sample in samples]
        self._alpha = parameter_table(dataset.manifest["parameters"], dataset.samples, "alpha")
        self._beta = parameter_table(dataset.manifest["parameters"], dataset.samples, "beta")
        self._camera = np.array([sample.camera_to_world for sample in samples], np.float32)
        self._light = np.array([sample.light for sample in samples], np.float32)
        self._irradiance = np.array([sample.irradiance for sample in samples], np.float32)
        self._index = np.array([sample.index for sample in samples], np.int32)

    def take(self, positions: Integer[np.ndarray, "B"]) -> Batch:
        columns = (self._alpha, self._beta, self._camera, self._light, self._irradiance, self._index)
        image = np.stack([np.asarray(self._images[i]) for i in positions])
        if not np.isfinite(image).all():
            bad = next(i for i, x in zip(positions, image, strict=True) if not np.isfinite(x).all())
            raise InputError(self._files[bad], "has NaN or infinite pixels")
        return Batch(image, *(column[positions] for column in columns))


def take(dataset: Dataset, positions: Integer[np.ndarray, "B"]) -> Batch:
    """Samples of a packed dataset by position."""
    return _Table(replace(dataset, samples=tuple(dataset.samples[i] for i in positions))).take(
        np.arange(len(positions))
    )
