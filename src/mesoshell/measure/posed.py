"""Pictures of a material from the cameras and lights of renders, with their parameters.

Notation
S           side of a picture, pixels
pose        a render's camera, light and parameters
shift       of a fitted patch, (u, v), random in each picture, so that pictures of one patch differ
picture     premultiplied linear RGBA over black; the unit box, as renders show it                  (S, S, 4)

A generator makes another texture for each picture. A parameter that the renders do not vary has the material's default.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.dataset import Dataset, Sample
from mesoshell.io.material import parameter_vector
from mesoshell.shell.generator.model import generator_model
from mesoshell.shell.material.field import Point, inputs
from mesoshell.shell.material.loader import load_device_material
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.snapshot import pictures
from mesoshell.train.gan.state import GanConfig, Learner
from mesoshell.train.patch_renderer import PictureConfig, View, take_picture

#: Samples a ray: more do not change the scores of a fit. Pictures a call.
SAMPLES, BATCH = 96, 20


class Posed(NamedTuple):
    """A material as a source of pictures: (samples, seed) → (N, S, S, 4)."""

    name: str
    pictures: Callable[[list[Sample], int], Float[np.ndarray, "N S S 4"]]


def pose_material(bundle: Bundle, name: str, dataset: Dataset, picture: PictureConfig | None = None) -> Posed:
    """A material seen by the cameras of a dataset. picture: settings of the run that made it, if any. Raises InputError if it
    is neither a generator nor one patch that repeats."""
    width, height = dataset.samples[0].size
    if width != height:
        raise InputError(dataset.folder, f"has pictures of {width} × {height} pixels; expected squares")
    if bundle.generator is None and not bundle.wraps:
        raise InputError(name, "holds a texture with edges: give the generator, or a patch that repeats")
    size, fov = width, float(dataset.samples[0].fov)
    one_batch = _generated(bundle, name, picture, (size, fov)) if bundle.generator else _fitted(bundle, (size, fov))

    def made(samples: list[Sample], seed: int) -> Float[np.ndarray, "N S S 4"]:
        batches = []
        for i in range(0, len(samples), BATCH):
            some = samples[i : i + BATCH]
            full = some + some[-1:] * (BATCH - len(some))
            batches.append(np.asarray(one_batch(_shown(bundle, full, (seed, i))))[: len(some)])
        return np.concatenate(batches)

    return Posed(name, made)


def _shown(bundle: Bundle, samples: list[Sample], seed: tuple[int, int]) -> ImageBatch:
    """Poses of renders, with parameters normalised by the material's ranges, and a key each."""
    known = {p.name for p in bundle.parameters}
    values = [{k: x for k, x in sample.parameters.items() if k in known} for sample in samples]
    alpha, beta = (
        np.stack([parameter_vector(bundle, v, role, "the dataset") for v in values]).astype(np.float32)
        for role in ("alpha", "beta")
    )
    key = jax.random.fold_in(jax.random.key(seed[0]), seed[1])
    camera = np.array([s.camera_to_world for s in samples], np.float32)
    light, irradiance = (np.array([getattr(s, n) for s in samples], np.float32) for n in ("light", "irradiance"))
    keys = np.asarray(jax.random.key_data(jax.random.split(key, len(samples))))
    return ImageBatch(np.zeros((len(samples), 0, 0, 4), np.float32), alpha, beta, camera, light, irradiance, keys)


def _generated(
    bundle: Bundle, name: str, picture: PictureConfig | None, frame: tuple[int, float]
) -> Callable[[ImageBatch], np.ndarray]:
    maker = generator_model(bundle, name)
    g = maker.config
    taken = picture or PictureConfig(0, SAMPLES, 0.0, g.texels, g.height_rows, maker.octaves, planes=g.planes)
    taken = PictureConfig(**vars(taken) | {"size": frame[0], "fov": frame[1]})
    config = GanConfig(generator=g, picture=taken)
    learner = Learner(maker.generator, maker.decoder)
    return lambda batch: pictures(config, learner, maker.averages, batch, correction=maker.correction)


def _fitted(bundle: Bundle, frame: tuple[int, float]) -> Callable[[ImageBatch], np.ndarray]:
    loaded = load_device_material(bundle)
    size, fov = frame
    reach = 1.0 if bundle.tiles is None else 64.0  # patches: far enough to see all tiles
    config = PictureConfig(size, SAMPLES, fov, max(1, math.ceil(bundle.texel_density)))

    @jax.jit
    def batch(material, shown: ImageBatch) -> jax.Array:
        def one(shown: ImageBatch) -> jax.Array:
            k = jax.random.split(jax.random.wrap_key_data(shown.key))
            shift = jnp.append(jax.random.uniform(k[0], (2,), maxval=reach), 0.0)

            def see(point: Point) -> jax.Array:
                return inputs(material, loaded.layout, point._replace(xi=point.xi + shift))

            view = View(shown.camera_to_world, shown.light, shown.irradiance, shown.alpha)
            return take_picture(config, material.decoder, see, view, jax.random.uniform(k[1], (1, SAMPLES)))

        return jax.lax.map(one, shown)

    return partial(_called, batch, loaded.material)


def _called(batch: Callable, material, shown: ImageBatch) -> np.ndarray:
    return np.asarray(batch(material, jax.tree.map(jnp.asarray, shown)))
