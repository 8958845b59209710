"""Renders for training, step by step, nearer cameras later.

Alphabet
share      of the samples, farthest cameras first, that a step may see: from FIRST to all over `near_kimg`, in STAGES
step       counted from 0; what step i sees depends on the configuration, the dataset and i alone, so that a run may resume
row        place in the global batch; each has its own key
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Int

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.train.feed import Feed, take
from mesoshell.train.generate import Shown
from mesoshell.train.state import TrainConfig, sized

#: The farthest quarter at first, then one eighth of the way at a time.
FIRST, STAGES = 0.25, 8


def fitted(config: TrainConfig, dataset: Dataset) -> TrainConfig:
    """The configuration for a dataset. Raises InputError if its images are not of the configured size."""
    roles = [entry["role"] for entry in dataset.manifest["parameters"].values()]
    size, wanted = dataset.samples[0].size, config.picture.size
    if size != (wanted, wanted):
        raise InputError(
            dataset.folder,
            f"has images of {size[0]} × {size[1]} pixels; the experiment wants {wanted} × {wanted}: "
            f"mesoshell dataset pack … --size {wanted}",
        )
    config = replace(config, picture=replace(config.picture, fov=float(dataset.samples[0].fov)))
    return sized(config, roles.count("alpha"), roles.count("beta"))


def renders(config: TrainConfig, dataset: Dataset, host: int = 0, hosts: int = 1) -> Callable[[int], Shown]:
    """This host's rows of step i, as NumPy arrays. Raises InputError if hosts cannot share the batch, or data are too few."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    rows = config.batch // hosts
    far_first = sorted(dataset.samples, key=lambda sample: (-sample.radius, sample.index))
    feeds = []
    for stage in range(STAGES + 1):
        share = FIRST + (1 - FIRST) * stage / STAGES
        some = far_first[: max(hosts, round(share * len(far_first)))]
        feeds.append(Feed(replace(dataset, samples=tuple(some)), rows, config.seed + stage, host, hosts))

    def at(step: int) -> Shown:
        kimg = step * config.batch / 1000
        stage = STAGES if kimg >= config.near_kimg else int(STAGES * kimg / config.near_kimg)
        b = feeds[stage][step]
        key = jax.random.fold_in(jax.random.key(config.seed), step)
        keys = jax.random.key_data(jax.random.split(key, config.batch))
        mine = np.asarray(keys)[host * rows : (host + 1) * rows]
        return Shown(b.image.astype(np.float32), b.alpha, b.beta, b.camera_to_world, b.light, b.irradiance, mine)

    return at


def views_of(config: TrainConfig, dataset: Dataset, positions: Int[np.ndarray, "B"] | list[int]) -> Shown:
    """The samples at these positions, with keys of their own: the same whenever they are asked for."""
    b = take(dataset, np.asarray(positions))
    keys = np.stack(
        [jax.random.key_data(jax.random.fold_in(jax.random.key(config.seed), i)) for i in range(len(positions))]
    )
    return Shown(b.image.astype(np.float32), b.alpha, b.beta, b.camera_to_world, b.light, b.irradiance, keys)
