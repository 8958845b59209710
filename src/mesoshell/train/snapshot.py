"""What a run shows of itself on the way: the material of the averaged weights, and a sheet of pictures.

Alphabet
folder      snapshots/IMAGES.npz, a bundle that `mesoshell render` takes; sheets/IMAGES.png, linear grey between pictures
sheet       rows of six: near renders, pictures from far cameras, and from the near renders' cameras, one texture a column; and
            beside them the first three features of 4 × 4 patches
"""

import subprocess
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.io.bundle import write_bundle
from mesoshell.io.dataset import Dataset
from mesoshell.io.image import tonemap, write_png
from mesoshell.io.sheet import tiled
from mesoshell.shell.generator import Averages, draw_phases, map_latent, synthesise
from mesoshell.train.export import declared, generator_bundle
from mesoshell.train.generate import Shown, generate
from mesoshell.train.parallel import in_turn
from mesoshell.train.state import Learner, TrainConfig, TrainState
from mesoshell.train.stream import views_of
from mesoshell.typing import Array

COLUMNS, EXTENT = 6, 4


def keep_snapshot(config: TrainConfig, dataset: Dataset, state: TrainState, folder: Path) -> None:
    """Write the snapshot and the sheet of this state; on the first host only."""
    if jax.process_index() != 0:
        return
    name = f"{int(state.images):09d}"
    for part in ("snapshots", "sheets"):
        (folder / part).mkdir(exist_ok=True)
    provenance = {"config": asdict(config), "dataset": origin(dataset), "commit": commit(), "images": int(state.images)}
    bundle = generator_bundle(config, state.smooth, state.averages, declared(dataset.manifest), provenance)
    write_bundle(folder / "snapshots" / f"{name}.npz", bundle)
    write_png(folder / "sheets" / f"{name}.png", sheet(config, state.smooth, state.averages, dataset))


def origin(dataset: Dataset) -> dict:
    """What a bundle says of the renders that it was made from."""
    kept = ("recipe", "version", "size", "samples_per_pixel", "seed")
    return {k: dataset.manifest[k] for k in kept} | {"images": len(dataset.samples)}


@lru_cache
def commit() -> str:
    """The commit of the working directory's repository, or "unknown"."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else "unknown"


def sheet(config: TrainConfig, learner: Learner, averages: Averages, dataset: Dataset) -> Float[np.ndarray, "h w 3"]:
    """Pictures of fixed seeds, as linear values to be shown."""
    far = views_of(config, dataset, _far_first(dataset)[:COLUMNS])
    near = views_of(config, dataset, _far_first(dataset)[-COLUMNS:])._replace(
        alpha=far.alpha, beta=far.beta, key=far.key
    )
    rows = [np.asarray(near.image)]
    rows += [np.maximum(pictures(config, learner, averages, batch)[..., :3], 0) for batch in (far, near)]
    shown = np.asarray(tiled(tonemap(np.concatenate([row[..., :3] for row in rows])), COLUMNS))
    side = EXTENT * config.generator.texels
    feature = np.asarray(_feature(config, side, learner, averages, far))
    wide = as_colours(feature)
    height = max(len(shown), side)
    parts = [np.pad(x, ((0, height - len(x)), (0, 0), (0, 0))) for x in (shown, wide)]
    return np.concatenate(parts, axis=1)


def as_colours(feature: Float[np.ndarray, "V U C"]) -> Float[np.ndarray, "V U 3"]:
    """The first three channels, their middle grey and two standard deviations black and white."""
    x = feature[..., :3]
    spread = np.maximum(x.std(axis=(0, 1)), 1e-6)
    return np.clip(0.5 + (x - x.mean(axis=(0, 1))) / (4 * spread), 0, 1).astype(np.float32) ** 2.2


def pictures(config: TrainConfig, learner: Learner, averages: Averages, batch: Shown) -> Float[np.ndarray, "B S S 4"]:
    """Generated pictures, a texture each, with the labels and keys of a batch."""
    return np.asarray(_pictures(replace(config, views=1), learner, averages, jax.tree.map(jnp.asarray, batch)))


@partial(jax.jit, static_argnums=0)
def _pictures(config: TrainConfig, learner: Learner, averages: Averages, batch: Shown) -> Array:
    return generate(config, learner, averages, batch, in_turn)[0]


@partial(jax.jit, static_argnums=(0, 1))
def _feature(config: TrainConfig, side: int, learner: Learner, averages: Averages, batch: Shown) -> Array:
    k = jax.random.split(jax.random.key(config.seed))
    z = jax.random.normal(k[0], (1, config.generator.z), jnp.float32)
    w = map_latent(learner.generator, z, batch.beta[:1])
    phases = draw_phases(config.generator, k[1], 1)
    corner = jnp.zeros(2, jnp.int32)
    return synthesise(config.generator, learner.generator, averages, w, phases, corner, (side, side)).feature[0]


def _far_first(dataset: Dataset) -> list[int]:
    """Positions of samples, the farthest first."""
    return sorted(range(len(dataset.samples)), key=lambda i: -dataset.samples[i].radius)
