"""Renders for training, step by step; nearer cameras come later.

Notation
share      of the samples, farthest cameras first, that a step may see: from FIRST to all over `near_kimg`, in STAGES
step       counted from 0; what step i sees depends on the configuration, the dataset and i alone, so that a run may resume
row        place in the global batch; each has its own key
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Int

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.shell.generator.discriminator import GROUP
from mesoshell.train.gan.discriminators import KINDS, kind_of
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.state import GanConfig, sized_for
from mesoshell.train.loader import Feed, open_shards, take
from mesoshell.train.patch_renderer import PictureConfig

#: The farthest quarter at first; then an eighth of the rest a stage.
FIRST, STAGES = 0.25, 8


@runtime_checkable
class Paced(Protocol):
    """Fields of a configuration that decide which renders a step sees."""

    @property
    def batch(self) -> int: ...
    @property
    def near_kimg(self) -> float: ...
    @property
    def seed(self) -> int: ...


def adapt(config: GanConfig, dataset: Dataset) -> tuple[GanConfig, Dataset]:
    """The configuration adapted to a dataset, and the dataset with only the parameters that vary. Raises InputError if its
    images have another size, or if the discriminator's groups could hold views of one texture, which renders never do."""
    _check(config)
    if kind_of(config.discriminator).grouped and config.views > max(
        config.batch // GROUP if config.batch % GROUP == 0 else 1, 1
    ):
        raise InputError(
            "views", f"{config.views} of a texture need a batch of {GROUP * config.views}, not {config.batch}"
        )
    varied = varying(dataset)
    roles = [entry["role"] for entry in varied.manifest["parameters"].values()]
    if config.mismatch and not roles:
        raise InputError("mismatch", "needs a dataset with parameters, which it exchanges between renders")
    config = replace(config, picture=adapt_picture(config.picture, dataset))
    return sized_for(config, roles.count("alpha"), roles.count("beta")), varied


def _check(config: GanConfig) -> None:
    """Raise InputError for fields that do not fit each other."""
    made, shown, seen = config.generator, config.picture, config.discriminator
    pairs = {
        "discriminator.size": (seen.size, "picture.size", shown.size),
        "picture.texels": (shown.texels, "generator.texels", made.texels),
        "picture.height_rows": (shown.height_rows, "generator.height_rows", made.height_rows),
        "picture.planes": (shown.planes, "generator.planes", made.planes),
    }
    for name, (value, other, wanted) in pairs.items():
        if value != wanted:
            raise InputError(name, f"is {value}, and {other} is {wanted}: they must be the same")
    if seen.kind not in KINDS:
        raise InputError("discriminator.kind", f"is {seen.kind!r}; there are {', '.join(KINDS)}")
    if config.r1_every < 1:
        raise InputError("r1_every", f"must be at least 1, not {config.r1_every}")


def varying(dataset: Dataset) -> Dataset:
    """The dataset without the parameters that are the same in all its renders, whose effect cannot be learned."""
    fixed = dataset.manifest.get("fixed_parameters", {})
    kept = {name: entry for name, entry in dataset.manifest["parameters"].items() if name not in fixed}
    return replace(dataset, manifest=dataset.manifest | {"parameters": kept})


def adapt_picture(picture: PictureConfig, dataset: Dataset) -> PictureConfig:
    """With the field of view of a dataset. Raises InputError if its images have another size."""
    size, wanted = dataset.samples[0].size, picture.size
    if size != (wanted, wanted):
        raise InputError(
            dataset.folder,
            f"has images of {size[0]} × {size[1]} pixels; the experiment expects {wanted} × {wanted}: "
            f"mesoshell dataset pack … --size {wanted}",
        )
    return replace(picture, fov=float(dataset.samples[0].fov))


def renders(config: Paced, dataset: Dataset, host: int = 0, hosts: int = 1) -> Callable[[int], ImageBatch]:
    """This host's rows of step i, as NumPy arrays. Raises InputError if hosts cannot share the batch, or data are too few."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    rows = config.batch // hosts
    far_first = sorted(dataset.samples, key=lambda sample: (-sample.radius, sample.index))
    feeds, shards = [], open_shards(dataset)
    for stage in range(STAGES + 1):
        share = FIRST + (1 - FIRST) * stage / STAGES
        some = far_first[: max(hosts, round(share * len(far_first)))]
        feeds.append(Feed(replace(dataset, samples=tuple(some)), rows, config.seed + stage, host, hosts, shards))

    def at(step: int) -> ImageBatch:
        kimg = step * config.batch / 1000
        stage = STAGES if kimg >= config.near_kimg else int(STAGES * kimg / config.near_kimg)
        b = feeds[stage][step]
        key = jax.random.fold_in(jax.random.key(config.seed), step)
        keys = jax.random.key_data(jax.random.split(key, config.batch))
        mine = np.asarray(keys)[host * rows : (host + 1) * rows]
        return ImageBatch(b.image.astype(np.float32), b.alpha, b.beta, b.camera_to_world, b.light, b.irradiance, mine)

    return at


def views_of(config: Paced, dataset: Dataset, positions: Int[np.ndarray, "B"] | list[int]) -> ImageBatch:
    """The samples at these positions, each with a key: the same in every call."""
    b = take(dataset, np.asarray(positions))
    keys = np.stack(
        [jax.random.key_data(jax.random.fold_in(jax.random.key(config.seed), i)) for i in range(len(positions))]
    )
    return ImageBatch(b.image.astype(np.float32), b.alpha, b.beta, b.camera_to_world, b.light, b.irradiance, keys)
