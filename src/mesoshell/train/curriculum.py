"""Renders for training, step by step, nearer cameras later.

Notation
share      of the samples, farthest cameras first, that a step may see: from FIRST to all over `near_kimg`, in STAGES
step       counted from 0; what step i sees depends on the configuration, the dataset and i alone, so that a run may resume
row        place in the global batch; each has its own key
seed       of a sample's geometry, as one more β: (i + ½)/n for the i-th of n samples, so that no two are alike in float32
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Int

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.shell.generator.discriminator import GROUP
from mesoshell.train.fit.step import FitConfig
from mesoshell.train.gan.generate import Shown
from mesoshell.train.gan.state import TrainConfig, sized
from mesoshell.train.loader import Feed, take
from mesoshell.train.nerf_tex.network import ParametricConfig
from mesoshell.train.neutex.step import AtlasTraining
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.train.surface.step import SurfaceTraining
from mesoshell.train.textures.state import TexturesConfig

#: What a run, of any method, depends on beside the data.
RunConfig = TrainConfig | ParametricConfig | SurfaceTraining | AtlasTraining | FitConfig | TexturesConfig
#: The name of the seed among parameters; not one that a recipe could use.
SEED = "geometry seed"

#: The farthest quarter at first, then one eighth of the way at a time.
FIRST, STAGES = 0.25, 8


def fitted(config: TrainConfig, dataset: Dataset) -> tuple[TrainConfig, Dataset]:
    """The configuration for a dataset, and the dataset with what varies in it. Raises InputError if its images are not of the
    configured size, or the discriminator could compare views of one texture with each other, which renders do not have."""
    if config.batch % GROUP == 0 and config.views > config.batch // GROUP:
        raise InputError(
            "views", f"{config.views} of a texture need a batch of {GROUP * config.views}, not {config.batch}"
        )
    seen = varying(dataset)
    roles = [entry["role"] for entry in seen.manifest["parameters"].values()]
    if config.mismatch and not roles:
        raise InputError("mismatch", "needs a dataset with parameters: without them no render is beside wrong ones")
    config = replace(config, picture=_fitted_picture(config.picture, dataset))
    return sized(config, roles.count("alpha"), roles.count("beta")), seen


def varying(dataset: Dataset) -> Dataset:
    """The dataset without the parameters that were the same in all its renders: what they do cannot be learned."""
    fixed = dataset.manifest.get("fixed_parameters", {})
    kept = {name: entry for name, entry in dataset.manifest["parameters"].items() if name not in fixed}
    return replace(dataset, manifest=dataset.manifest | {"parameters": kept})


def fitted_parametric(config: ParametricConfig, dataset: Dataset) -> tuple[ParametricConfig, Dataset]:
    """The configuration for a dataset, and the dataset with what varies in it, its seeds too if the network sees them. Raises
    InputError if images are not of the configured size, or show other geometry each and no seed tells which, or the same and
    there is no need."""
    patch = dataset.manifest.get("patch", None if config.seeded else 0)
    if patch is None and not config.seeded:
        raise InputError(
            dataset.folder,
            "every image shows another geometry, which this network cannot tell apart: render one patch "
            f"(mesoshell dataset render {dataset.recipe} --patch 0 …), or train experiments/nerf_tex_seed.py",
        )
    if patch is not None and config.seeded:
        raise InputError(
            dataset.folder, f"every image shows patch {patch}; seeds as a parameter need a dataset without --patch"
        )
    dataset = with_seeds(varying(dataset)) if config.seeded else varying(dataset)
    picture = _fitted_picture(config.picture, dataset)
    return replace(config, picture=picture, parameters=len(dataset.manifest["parameters"])), dataset


def with_seeds(dataset: Dataset) -> Dataset:
    """The dataset with one more parameter, the last of its β: which geometry a sample shows."""
    entry = {"role": "beta", "range": [0.0, 1.0], "default": 0.5, "unit": "1", "meaning": "which geometry"}
    manifest = dataset.manifest | {"parameters": dataset.manifest["parameters"] | {SEED: entry}}
    count = len(dataset.samples)
    samples = tuple(
        replace(sample, parameters=sample.parameters | {SEED: (i + 0.5) / count})
        for i, sample in enumerate(dataset.samples)
    )
    return replace(dataset, manifest=manifest, samples=samples)


def _fitted_picture(picture: PictureConfig, dataset: Dataset) -> PictureConfig:
    size, wanted = dataset.samples[0].size, picture.size
    if size != (wanted, wanted):
        raise InputError(
            dataset.folder,
            f"has images of {size[0]} × {size[1]} pixels; the experiment wants {wanted} × {wanted}: "
            f"mesoshell dataset pack … --size {wanted}",
        )
    return replace(picture, fov=float(dataset.samples[0].fov))


def renders(
    config: TrainConfig | ParametricConfig, dataset: Dataset, host: int = 0, hosts: int = 1
) -> Callable[[int], Shown]:
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


def views_of(
    config: TrainConfig | ParametricConfig, dataset: Dataset, positions: Int[np.ndarray, "B"] | list[int]
) -> Shown:
    """The samples at these positions, with keys of their own: the same whenever they are asked for."""
    b = take(dataset, np.asarray(positions))
    keys = np.stack(
        [jax.random.key_data(jax.random.fold_in(jax.random.key(config.seed), i)) for i in range(len(positions))]
    )
    return Shown(b.image.astype(np.float32), b.alpha, b.beta, b.camera_to_world, b.light, b.irradiance, keys)
