"""Generate pictures of random textures, and the labels that the discriminator sees with pictures.

Notation
B            pictures a step; each row has its own random key, so that its numbers do not depend on the device
T            textures a step: each is seen in `views` consecutive pictures of the batch
c            label: α, β (both in turns), direction to the camera from the box's centre, log of its distance, direction to the
             light                                                                (B, L)
each         applies a function of one row to all rows: at once, or in turn

A texture costs four times what a picture of it costs, so a second view of it is cheap.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.shell.generator.generator import (
    Averages,
    Phases,
    draw_phases,
    in_turns,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.material.field import inputs
from mesoshell.train.gan.regularise import roughness
from mesoshell.train.gan.state import GanConfig, Learner
from mesoshell.train.patch_renderer import View, material_of, take_picture
from mesoshell.typing import Array, Float, Scalar


class ImageBatch(NamedTuple):
    """Renders of a step with their labels, and the keys of as many generated pictures. image: linear RGBA.

    NumPy arrays on the host, JAX arrays in a step."""

    image: Any  # (B, S, S, 4)
    alpha: Any  # (B, A)
    beta: Any  # (B, G)
    camera_to_world: Any  # (B, 4, 4)
    light: Any  # (B, 3)
    irradiance: Any  # (B, 3)
    key: Any  # (B, 2), uint32


class GeneratorStats(NamedTuple):
    """Statistics of a step. magnitude: mean squares of the layers' inputs; w: its mean; roughness: see regularise."""

    magnitude: list[Scalar]
    w: Float[Array, "W"]
    roughness: Scalar


def label(batch: ImageBatch) -> Float[Array, "B L"]:
    """c."""
    toward = batch.camera_to_world[:, :3, 3] - 0.5
    distance = jnp.sqrt(jnp.sum(toward**2, axis=1, keepdims=True))
    about = in_turns(jnp.concatenate([batch.alpha, batch.beta], axis=1))
    return jnp.concatenate([about, toward / distance, jnp.log(distance), batch.light], axis=1)


def conditions(config: GanConfig, batch: ImageBatch) -> ImageBatch:
    """The conditions of generated pictures: all views of a texture have the parameters of the first."""

    def first(x: Array) -> Array:
        return jnp.repeat(x[:: config.views], config.views, axis=0)

    return batch._replace(alpha=first(batch.alpha), beta=first(batch.beta))


def generate(
    config: GanConfig,
    learner: Learner,
    averages: Averages,
    batch: ImageBatch,
    each: Callable[[Callable], Callable],
    tile: tuple[int, int] = (0, 0),
    correction: Float[Array, "L K C"] | None = None,
) -> tuple[Float[Array, "B S S 4"], GeneratorStats]:
    """Pictures of fresh textures from the batch's cameras, lights and parameters (from `conditions`). tile: of the plane;
    correction: of the material's levels (train/prefilter)."""
    keys = jax.vmap(lambda k: jax.random.split(k, 3))(jax.random.wrap_key_data(batch.key))
    textures = keys[:: config.views]
    dtype = batch.alpha.dtype
    z = jax.vmap(lambda k: jax.random.normal(k, (config.generator.z,), jnp.float32))(textures[:, 0]).astype(dtype)
    phases = jax.vmap(lambda k: draw_phases(config.generator, k, 1))(textures[:, 1])
    phases = Phases(*jax.tree.map(lambda p: p[:, 0].astype(dtype), (phases.input, phases.layers)))
    w = map_latent(learner.generator, z, batch.beta[:: config.views])
    side = config.generator.texels
    corner = jnp.array(tile, jnp.int32)
    texture = synthesise(config.generator, learner.generator, averages, w, phases, corner, (side, side))
    height = synthesise_height(config.generator, learner.generator, w)

    def one(feature: Array, height: Array, view: View, key: Array) -> tuple[Array, Array]:
        # one row for all rays: with one for each, thin layers turn into noise, to which the generator adapts
        jitter = jax.random.uniform(key, (1, config.picture.samples), jnp.float32).astype(dtype)
        material = material_of(config.picture, feature, height, learner.decoder)._replace(correction=correction)
        rough = roughness(config.picture, material, view.alpha, key) if config.density else jnp.zeros((), dtype)
        see = partial(inputs, material, config.picture.layout)
        return take_picture(config.picture, learner.decoder, see, view, jitter), rough

    views = View(batch.camera_to_world, batch.light, batch.irradiance, batch.alpha)
    feature, height = (jnp.repeat(x, config.views, axis=0) for x in (texture.feature, height))
    pictures, rough = each(one)(feature, height, views, keys[:, 2])
    return pictures, GeneratorStats(texture.magnitude, jax.lax.stop_gradient(jnp.mean(w, axis=0)), jnp.mean(rough))
