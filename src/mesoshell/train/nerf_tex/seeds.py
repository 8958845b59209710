"""Adapt a dataset to the NeRF-Tex network: parameters that vary, and the geometry's seed as one more parameter.

Notation
seed       of a sample's geometry, as one more β: (i + ½)/n for the i-th of n samples, so that no two are alike in float32
"""

from dataclasses import replace

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.train.gan.curriculum import adapt_picture, varying
from mesoshell.train.nerf_tex.network import NerfTexConfig

#: The name of the seed among parameters; not one that a recipe can use.
SEED = "geometry seed"


def adapt(config: NerfTexConfig, dataset: Dataset) -> tuple[NerfTexConfig, Dataset]:
    """The configuration adapted to a dataset, and the dataset with the parameters that vary, and with seeds if the network sees
    them. Raises InputError if images have another size, if each shows another geometry and `seeded` is off, or if all show one
    geometry and `seeded` is on."""
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
    picture = adapt_picture(config.picture, dataset)
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
