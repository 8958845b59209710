"""Snapshots of a GAN's run: the material of the averaged weights, and a sheet of pictures.

Notation
snapshot    a bundle that `mesoshell render` takes
sheet       rows of six: near renders, then pictures from far cameras and from the near renders' cameras, a texture a column;
            beside them the first three features of 4 × 4 patches
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.checkout import commit
from mesoshell.io.dataset import Dataset, origin
from mesoshell.io.image import tonemap
from mesoshell.io.sheet import tile_pictures
from mesoshell.shell.generator.generator import Averages, draw_phases, map_latent, synthesise
from mesoshell.shell.generator.model import generator_model
from mesoshell.train.export import declared_parameters, generator_bundle
from mesoshell.train.gan.curriculum import Paced, views_of
from mesoshell.train.gan.generate import ImageBatch, generate
from mesoshell.train.gan.state import GanConfig, Learner, TrainState
from mesoshell.train.parallel import in_turn
from mesoshell.typing import Array

COLUMNS, EXTENT = 6, 4


def save(path: Path, config: GanConfig, dataset: Dataset, state: TrainState) -> None:
    """The material of the averaged weights, as a bundle."""
    about = provenance(config, dataset, int(state.images))
    write_bundle(
        path, generator_bundle(config, state.smooth, state.averages, declared_parameters(dataset.manifest), about)
    )


def load_predictor(config: GanConfig, path: Path) -> Callable[[ImageBatch], Float[np.ndarray, "B S S 4"]]:
    """A function that makes pictures of a snapshot, a texture each, with the labels and keys of a batch."""
    maker = generator_model(read_bundle(path), str(path))
    learner = Learner(maker.generator, maker.decoder)
    return lambda batch: pictures(config, learner, maker.averages, batch)


def provenance(config: Any, dataset: Dataset, images: int) -> dict:
    """Where a snapshot comes from."""
    return {"config": asdict(config), "dataset": origin(dataset), "commit": commit(), "images": images}


def sheet(config: GanConfig, dataset: Dataset, state: TrainState) -> Float[np.ndarray, "h w 3"]:
    """Pictures of fixed seeds, as linear values to be shown."""
    learner, averages = state.smooth, state.averages
    far, near = ends(config, dataset)
    far = far._replace(alpha=near.alpha, beta=near.beta, key=near.key)
    rows = [near.image, *(pictures(config, learner, averages, batch) for batch in (far, near))]
    shown = in_rows(rows)
    side = EXTENT * config.generator.texels
    feature = np.asarray(_feature(config, side, learner, averages, far))
    wide = as_colours(feature)
    height = max(len(shown), side)
    parts = [np.pad(x, ((0, height - len(x)), (0, 0), (0, 0))) for x in (shown, wide)]
    return np.concatenate(parts, axis=1)


def ends(config: Paced, dataset: Dataset) -> tuple[ImageBatch, ImageBatch]:
    """The farthest renders, and the nearest, COLUMNS of each."""
    far_first = sorted(range(len(dataset.samples)), key=lambda i: -dataset.samples[i].radius)
    return views_of(config, dataset, far_first[:COLUMNS]), views_of(config, dataset, far_first[-COLUMNS:])


def in_rows(rows: list[np.ndarray]) -> Float[np.ndarray, "h w 3"]:
    """Linear RGBA pictures, a row each, as values to be shown."""
    radiance = np.concatenate([np.maximum(np.asarray(row)[..., :3], 0) for row in rows])
    return np.asarray(tile_pictures(tonemap(radiance), COLUMNS))


def as_colours(feature: Float[np.ndarray, "V U C"]) -> Float[np.ndarray, "V U 3"]:
    """The first three channels as colours: the mean is grey; two standard deviations below and above are black and white."""
    x = feature[..., :3]
    spread = np.maximum(x.std(axis=(0, 1)), 1e-6)
    return np.clip(0.5 + (x - x.mean(axis=(0, 1))) / (4 * spread), 0, 1).astype(np.float32) ** 2.2


def pictures(
    config: GanConfig,
    learner: Learner,
    averages: Averages,
    batch: ImageBatch,
    tile: tuple[int, int] = (0, 0),
    correction: Float[np.ndarray, "L K C"] | None = None,
) -> Float[np.ndarray, "B S S 4"]:
    """Generated pictures of a tile of the plane, a texture each, with the labels and keys of a batch. correction: of the
    material's levels."""
    given = jax.tree.map(jnp.asarray, (batch, correction))
    return np.asarray(_pictures(replace(config, views=1), tile, learner, averages, *given))


@partial(jax.jit, static_argnums=(0, 1))
def _pictures(
    config: GanConfig,
    tile: tuple[int, int],
    learner: Learner,
    averages: Averages,
    batch: ImageBatch,
    correction: Float[Array, "L K C"] | None,
) -> Array:
    return generate(config, learner, averages, batch, in_turn, tile, correction)[0]


@partial(jax.jit, static_argnums=(0, 1))
def _feature(config: GanConfig, side: int, learner: Learner, averages: Averages, batch: ImageBatch) -> Array:
    k = jax.random.split(jax.random.key(config.seed))
    z = jax.random.normal(k[0], (1, config.generator.z), jnp.float32)
    w = map_latent(learner.generator, z, batch.beta[:1])
    phases = draw_phases(config.generator, k[1], 1)
    corner = jnp.zeros(2, jnp.int32)
    return synthesise(config.generator, learner.generator, averages, w, phases, corner, (side, side)).feature[0]
