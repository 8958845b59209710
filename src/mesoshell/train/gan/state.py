"""Configuration, state and start of a GAN's run.

Notation
kimg       thousands of renders shown to the discriminator
A, G       number of appearance and of geometry parameters of the dataset
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mesoshell.nets.mlp import Dense
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.generator import Averages, Generator, init_averages, init_generator
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.material.decoder import Decoder, init_decoder
from mesoshell.train.gan.discriminators import AnyDiscriminator, kind_of
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.typing import Array, Int, Key

#: The bias of the decoder's last layer at the start: ρ is 0.004, which under 40 W/m² is as dark as a render's median.
DARK = -3.5
#: Label entries beside α and β: direction to the camera, log of its distance, direction to the light.
POSE = 7


@dataclass(frozen=True)
class GanConfig:
    """Everything that a run depends on beside the data.

    gamma: weight of R1, each r1_every steps; pixel_gamma: the residual discriminator's over it, where heads judge beside it;
    taught: all that makes materials, or the plane's layers alone, while F(h), decoder and mapping stay as they began;
    kimg: length of the run; near_kimg: when the nearest cameras are reached, from the farthest at first; views: pictures of
    each texture; blur: deviation in pixels, at first, of the blur before the discriminator, 0 from blur_kimg on; density:
    weight of the density's roughness; mismatch: weight of renders with other renders' parameters, which the discriminator
    must also reject; precision: of convolutions but the discriminator's last, except in R1, which is always float32;
    snapshot_kimg: how often a run keeps a material and a sheet.
    """

    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)
    picture: PictureConfig = field(default_factory=PictureConfig)
    trunk: tuple[int, ...] = (64, 64)
    head: tuple[int, ...] = (64, 64)
    appearance: int = 0
    batch: int = 8
    kimg: float = 200.0
    near_kimg: float = 20.0
    generator_rate: float = 2.5e-3
    discriminator_rate: float = 2e-3
    gamma: float = 0.5
    pixel_gamma: float = 0.03
    taught: Literal["all", "plane"] = "all"
    r1_every: int = 16
    views: int = 1
    blur: float = 0.0
    blur_kimg: float = 20.0
    density: float = 0.0
    mismatch: float = 0.0
    precision: Literal["float32", "bfloat16"] = "float32"
    snapshot_kimg: float = 2.0
    seed: int = 0


class Learner(NamedTuple):
    """The networks that make materials: the generator of features, and the decoder."""

    generator: Generator
    decoder: Decoder


class TrainState(NamedTuple):
    """A run under way; a pytree of arrays. smooth: weight average of the learner; images: renders seen."""

    learner: Learner
    smooth: Learner
    averages: Averages
    discriminator: AnyDiscriminator
    learner_adam: optax.OptState
    discriminator_adam: optax.OptState
    step: Int[Array, ""]
    images: Int[Array, ""]


def sized_for(config: GanConfig, appearance: int, geometry: int) -> GanConfig:
    """The configuration for a dataset with this many parameters, which set the inputs of discriminator, decoder and mapping."""
    return replace(
        config,
        appearance=appearance,
        generator=replace(config.generator, betas=geometry, precision=config.precision),
        picture=replace(config.picture, planes=config.generator.planes),
        discriminator=replace(config.discriminator, labels=3 * (appearance + geometry) + POSE),
    )


def optimisers(config: GanConfig) -> tuple[optax.GradientTransformation, optax.GradientTransformation]:
    """Adam (0, 0.99, 1e-8), for the learner and for the discriminator.

    All kernels but the decoder's are stored with unit variance and scaled where they are used. The decoder's are stored as
    they act, so their steps are multiplied by 1/√inputs, to learn at the same pace. The scale of σ stays. The
    discriminator takes r1_every + 1 updates while the learner takes r1_every: its rate is lowered, and its memory lengthened,
    in that proportion (StyleGAN2, appendix B).
    """
    lazy = config.r1_every / (config.r1_every + 1)
    return (
        optax.chain(
            optax.scale_by_adam(0.0, 0.99, 1e-8),
            optax.stateless(_at_one_pace),
            optax.stateless(_of_the_plane) if config.taught == "plane" else optax.identity(),
            optax.scale(-config.generator_rate),
        ),
        optax.adam(config.discriminator_rate * lazy, 0.0, 0.99**lazy, 1e-8),
    )


def _at_one_pace(updates: Any, parameters: Any) -> Any:
    def slowed(x: Dense | Array) -> Dense | Array:
        return Dense(x.kernel / x.kernel.shape[0] ** 0.5, x.bias) if isinstance(x, Dense) else jnp.zeros_like(x)

    return updates._replace(decoder=jax.tree.map(slowed, updates.decoder, is_leaf=lambda x: isinstance(x, Dense)))


def _of_the_plane(updates: Any, parameters: Any) -> Any:
    still, made = jax.tree.map(jnp.zeros_like, updates), updates.generator
    return still._replace(generator=still.generator._replace(mix=made.mix, strength=made.strength, layers=made.layers))


def start(config: GanConfig, key: Key[Array, ""]) -> TrainState:
    """A state before training."""
    k = jax.random.split(key, 3)
    encoded = config.generator.channels + 1 + 2 * config.picture.octaves + config.appearance
    decoder = init_decoder(k[1], encoded, config.trunk, config.head)
    dark = decoder._replace(rho=decoder.rho._replace(bias=decoder.rho.bias + DARK))
    learner = Learner(init_generator(config.generator, k[0]), dark)
    discriminator = kind_of(config.discriminator).start(config.discriminator, k[2])
    for_learner, for_discriminator = optimisers(config)
    return TrainState(
        learner,
        jax.tree.map(jnp.copy, learner),
        init_averages(config.generator),
        discriminator,
        for_learner.init(learner),
        for_discriminator.init(discriminator),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )
