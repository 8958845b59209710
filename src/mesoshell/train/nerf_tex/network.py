"""NeRF-Tex, for comparison: one network of a point, two directions and the parameters, fitted to renders.

It has no texture, no latent and no discriminator (MesoGAN, section 6.3 and appendix B).

Notation
B, P         pictures a step; normalised parameters that the network sees: all α, all β, and with `seeded` the geometry's seed
ξ            (u, v, h): the network sees it and sin, cos of π·2ᵏ·ξ for `octaves` values of k
p            parameters in [0, 1], encoded in the same way with PARAMETER_OCTAVES values of k
loss         SMAPE of linear radiance, and mean square error of transmittance, over all pixels

The network is the project's own decoder: its trunk gives σ, its head ρ. With `seeded` it also sees a seed for the geometry:
each render has its own number in [0, 1], and a new picture draws one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mesoshell.shell.material.decoder import Decoder, encode_height, init_decoder
from mesoshell.shell.material.field import Point
from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.losses import smape, transmittance_loss
from mesoshell.train.patch_renderer import PictureConfig, View, take_picture
from mesoshell.train.update import HERE, Across, apply_gradient, not_finite
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

PARAMETER_OCTAVES = 4


@dataclass(frozen=True)
class NerfTexConfig:
    """Everything that a run depends on beside the data; for fields shared with GanConfig, see there.

    octaves: of the encoding of ξ; rate: Adam's; parameters: P, which follows from the dataset.
    """

    picture: PictureConfig = field(default_factory=PictureConfig)
    trunk: tuple[int, ...] = (128, 128, 128, 128)
    head: tuple[int, ...] = (64,)
    octaves: int = 7
    batch: int = 8
    kimg: float = 200.0
    near_kimg: float = 20.0
    rate: float = 1e-3
    snapshot_kimg: float = 2.0
    seed: int = 0
    parameters: int = 0
    seeded: bool = False


class NerfTexState(NamedTuple):
    """A run under way; a pytree of arrays. images: renders seen."""

    decoder: Decoder
    adam: optax.OptState
    step: Int[Array, ""]
    images: Int[Array, ""]


class NerfTexReport(NamedTuple):
    """Both parts of the loss, and which leaves of the gradient are not finite."""

    radiance: Scalar
    transmittance: Scalar
    bad: Bool[Array, "_leaves"]


def nerf_tex_config(preset: GanConfig, seeded: bool = False) -> NerfTexConfig:
    """The network at a preset's size. Since no texture stores the patch, it has twice the decoder's width and
    four layers in its trunk; the shortest wave of its encoding is two of the preset's texels long."""
    width = preset.trunk[0]
    return NerfTexConfig(
        picture=preset.picture,
        trunk=(2 * width,) * 4,
        head=(width,),
        octaves=preset.picture.texels.bit_length(),
        batch=preset.batch,
        kimg=preset.kimg,
        near_kimg=preset.near_kimg,
        snapshot_kimg=preset.snapshot_kimg,
        seed=preset.seed,
        seeded=seeded,
    )


def start(config: NerfTexConfig, key: Key[Array, ""]) -> NerfTexState:
    """A state before training."""
    inputs = 3 * (1 + 2 * config.octaves) + config.parameters * (1 + 2 * PARAMETER_OCTAVES)
    decoder = init_decoder(key, inputs, config.trunk, config.head)
    adam = optimiser(config).init(decoder)
    return NerfTexState(decoder, adam, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def step(
    config: NerfTexConfig, state: NerfTexState, batch: ImageBatch, across: Across = HERE
) -> tuple[NerfTexState, NerfTexReport]:
    """One update. Pure."""

    def loss(decoder: Decoder) -> tuple[Scalar, tuple[Scalar, Scalar]]:
        made = paint(config, decoder, batch, across.each)
        radiance = smape(made[..., :3], batch.image[..., :3])
        transmittance = transmittance_loss(made[..., 3], batch.image[..., 3])
        return radiance + transmittance, (radiance, transmittance)

    (_, parts), gradient = jax.value_and_grad(loss, has_aux=True)(state.decoder)
    parts, gradient = across.mean((parts, gradient))
    decoder, adam = apply_gradient(optimiser(config), state.decoder, state.adam, gradient)
    rows, bad = across.rows(batch.alpha), not_finite(gradient)
    return NerfTexState(decoder, adam, state.step + 1, state.images + rows), NerfTexReport(parts[0], parts[1], bad)


def paint(
    config: NerfTexConfig, decoder: Decoder, batch: ImageBatch, each: Callable[[Callable], Callable]
) -> Float[Array, "B S S 4"]:
    """Pictures from a batch's cameras, lights and parameters, the seeds among its β included."""
    keys = jax.random.wrap_key_data(batch.key)
    parameters = jnp.concatenate([batch.alpha, batch.beta], axis=1)
    shape = (config.picture.size**2, config.picture.samples)

    def one(view: View, key: Array) -> Array:
        jitter = jax.random.uniform(key, shape, jnp.float32).astype(view.alpha.dtype)
        return take_picture(config.picture, decoder, partial(see, config), view, jitter)

    return each(one)(View(batch.camera_to_world, batch.light, batch.irradiance, parameters), keys)


def see(config: NerfTexConfig, point: Point) -> Float[Array, "I"]:
    """The network's input at a point: ξ and p, each with its sines and cosines."""
    place = jax.vmap(lambda x: encode_height(x, config.octaves))(point.xi)
    parameters = jax.vmap(lambda x: encode_height(x, PARAMETER_OCTAVES))(point.alpha)
    return jnp.concatenate([place.reshape(-1), parameters.reshape(-1)])


def redrawn(config: NerfTexConfig, batch: ImageBatch) -> ImageBatch:
    """The batch with new seeds, drawn by its keys; unchanged if the network sees no seed."""
    if not config.seeded:
        return batch
    keys = jax.vmap(lambda k: jax.random.fold_in(k, 1))(jax.random.wrap_key_data(jnp.asarray(batch.key)))
    seeds: Any = jax.vmap(lambda k: jax.random.uniform(k, (1,), jnp.float32))(keys)
    return batch._replace(beta=jnp.concatenate([jnp.asarray(batch.beta)[:, :-1], seeds], axis=1))


def optimiser(config: NerfTexConfig) -> optax.GradientTransformation:
    """Adam, at the configured rate."""
    return optax.adam(config.rate)
