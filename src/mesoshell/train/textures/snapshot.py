"""Snapshots of a run on textures: the material, and a sheet of its textures.

sheet    rows: exemplars; the generator at their phases; the generator at new phases. Columns, for each of PATCHES: pictures of
         the box from three sides, then the height seen from above
"""

import math
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.checkout import commit
from mesoshell.numerics import normalise
from mesoshell.render.camera import look_at
from mesoshell.render.composite import tonemap
from mesoshell.shell.generator.generator import synthesise, synthesise_height
from mesoshell.shell.material.field import inputs
from mesoshell.train.export import generated_bundle
from mesoshell.train.patch_renderer import PictureConfig, View, material_of, take_picture
from mesoshell.train.textures.depth_map import from_above
from mesoshell.train.textures.exemplars import ScaledExemplars
from mesoshell.train.textures.state import TexturesConfig, TexturesState
from mesoshell.train.textures.synthesis import fold, latents, own_phases, phases_of, settle_moments
from mesoshell.typing import Array

PATCHES, SIDE = 2, 128
#: Cameras of a sheet: angle from the vertical, and around it, radians.
_CAMERAS = ((0.35, 0.5), (0.9, 2.0), (1.3, 4.0))
_DISTANCE, _LIGHT, _IRRADIANCE = 3.4, (0.4, 0.3, 0.85), 3.0


def save(path: Path, config: TexturesConfig, data: ScaledExemplars, state: TexturesState) -> None:
    """Write a state as a generator's bundle."""
    write_bundle(path, bundle(config, data, state))


def bundle(config: TexturesConfig, data: ScaledExemplars, state: TexturesState) -> Bundle:
    """The material of the averaged weights."""
    about: dict[str, Any] = {"config": asdict(config), "commit": commit(), "images": int(state.images)}
    about["exemplars"] = data.what.provenance
    octaves, declared = data.what.height_octaves, data.what.parameters
    state = settle_moments(config, state)
    made = fold(state.smooth, state), state.averages, state.decoder
    return generated_bundle(config.generator, *made, octaves, declared, about)


def sheet(config: TexturesConfig, data: ScaledExemplars, state: TexturesState) -> Float[np.ndarray, "h w 3"]:
    """Pictures of textures, as linear values to be shown."""
    count, side = len(data.features), config.generator.texels
    state = settle_moments(config, state)
    patch = np.arange(PATCHES) % count
    beta = jnp.asarray(data.what.beta[patch])
    own = _made(config, state, beta, own_phases(config, jnp.asarray(patch)))
    new = _made(config, state, beta, phases_of(config, jax.random.split(jax.random.key(10_000 + config.seed), PATCHES)))
    heights = jnp.broadcast_to(state.height, (PATCHES, *state.height.shape))
    octaves, alphas = data.what.height_octaves, sum(p.role == "alpha" for p in data.what.parameters)
    rows = []
    shown = jnp.asarray(data.features[patch])[:, :side, :side]
    for feature, height in ((shown, heights), own, new):
        pictures = [_shown(octaves, alphas, state.decoder, f, h) for f, h in zip(feature, height, strict=True)]
        rows.append(np.concatenate([np.asarray(x) for x in pictures], axis=1))
    return np.concatenate(rows, axis=0)


def load_predictor(config: TexturesConfig, path: Path) -> Callable[[Any], Any]:
    """Raise InputError: such a run has no renders to compare with."""
    raise InputError(path, "is of a run on textures, which has no renders to compare with")


@partial(jax.jit, static_argnums=0)
def _made(config: TexturesConfig, state: TexturesState, beta: Array, phases: Any) -> tuple[Array, Array]:
    """Textures at these phases, and their height features."""
    generator, side = fold(state.smooth, state), config.generator.texels
    w, at = latents(config, generator, beta), jnp.zeros(2, jnp.int32)
    texture = synthesise(config.generator, generator, state.averages, w, phases, at, (side, side))
    return texture.feature, synthesise_height(config.generator, generator, w)


@partial(jax.jit, static_argnums=(0, 1))
def _shown(octaves: int, alphas: int, decoder: Any, feature: Array, height: Array) -> Float[Array, "h w 3"]:
    """Pictures of the box, and its depth from above, side by side."""
    config = PictureConfig(size=SIDE, samples=64, texels=feature.shape[0], height_rows=height.shape[0], octaves=octaves)
    alpha = jnp.full(alphas, 0.2)
    light = normalise(jnp.asarray(_LIGHT))
    material = material_of(config, feature, height, decoder)
    jitter = jnp.full((1, config.samples), 0.5)
    pictures = []
    for camera in _cameras():
        view = View(jnp.asarray(camera, jnp.float32), light, jnp.full(3, _IRRADIANCE), alpha)
        rgba = take_picture(config, decoder, partial(inputs, material, config.layout), view, jitter)
        pictures.append(tonemap(jnp.maximum(rgba[..., :3], 0)))
    depth = from_above(decoder, octaves, feature, height, alpha).depth
    depth = jax.image.resize(depth, (SIDE, SIDE), "nearest")
    return jnp.concatenate([*pictures, jnp.broadcast_to(depth[..., None] ** 2.2, (SIDE, SIDE, 3))], axis=1)


def _cameras() -> list[np.ndarray]:
    centre = np.array([0.5, 0.5, 0.25])
    cameras = []
    for down, about in _CAMERAS:
        toward = np.array([math.sin(down) * math.cos(about), math.sin(down) * math.sin(about), math.cos(down)])
        cameras.append(look_at(tuple(centre + _DISTANCE * toward), tuple(centre), (0.0, 0.0, 1.0)))
    return cameras
