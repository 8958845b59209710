"""A run on textures: its configuration, its state, its report of a step.

Notation
γ           weight of the critic's penalty (train/textures/adversarial)
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import optax

from mesoshell.errors import Argument, InputError
from mesoshell.io.bundle import Parameter
from mesoshell.io.exemplars import Exemplars
from mesoshell.shell.generator.generator import Averages, Generator
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import WINDOW, Critic, CriticConfig, grid_side
from mesoshell.shell.material.decoder import Decoder
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.textures.critic_view import CHANNELS
from mesoshell.train.textures.exemplars import ScaledExemplars, scale_exemplars
from mesoshell.typing import Array, Bool, Float, Int, Scalar


@dataclass(frozen=True)
class TexturesConfig:
    """Everything that a run depends on beside the exemplars. batch: B; kimg: thousands of rows; rate: Adam's, which falls along
    a cosine to `final` of itself; exemplars: how many of them, from the first on, 0 for all. adversarial: whether a critic
    teaches, and no regression: then rates hold for half of the run, and fall to 0; window: texels along a side of what the
    critic is shown; critic_rate, gamma: of the critic, the latter at first; balance: its loss that γ is steered to, where 0.69
    is chance. octaves: of the decoder; alphas: its appearance parameters; directions: which β are directions in the plane;
    these follow from the exemplars."""

    generator: GeneratorConfig = field(
        default_factory=lambda: GeneratorConfig(layers=7, channel_base=8192, waves=8, drift=1.5, z=0, texels=128)
    )
    critic: CriticConfig = field(default_factory=lambda: CriticConfig(CHANNELS))
    batch: int = 2
    kimg: float = 8.0
    rate: float = 3e-2
    final: float = 0.1
    exemplars: int = 0
    adversarial: bool = False
    window: int = 128
    critic_rate: float = 1.5e-3
    gamma: float = 2.0
    balance: float = 0.45
    octaves: int = 4
    alphas: int = 0
    directions: tuple[int, ...] = ()
    snapshot_kimg: float = 0.5
    seed: int = 0


def textures_config(preset: GanConfig) -> TexturesConfig:
    """A run at a preset's size: twice its texels a patch, 64 at least, with its channels. `tiny` is over in minutes."""
    texels, most = max(64, 2 * preset.generator.texels), preset.generator.channel_max
    config = TexturesConfig()
    generator = replace(config.generator, texels=texels, channel_base=most * texels, channel_max=most)
    return replace(config, generator=generator, kimg=0.04 if most < 64 else config.kimg)


def critic_config(preset: GanConfig) -> TexturesConfig:
    """A run against a critic at a preset's size: 64 texels a patch, with half as many channels again."""
    most = 3 * preset.generator.channel_max // 2
    generator = GeneratorConfig(
        layers=10,
        channel_base=64 * most,
        channel_max=most,
        waves=8,
        drift=1.5,
        z=0,
        texels=64,
        precision="bfloat16",
    )
    return TexturesConfig(generator, CriticConfig(CHANNELS, width=most), rate=2.5e-3, adversarial=True)


class CriticState(NamedTuple):
    """The critic, its optimiser, γ, and mean and deviation of its views of exemplars, which stay fixed."""

    critic: Critic
    adam: optax.OptState
    gamma: Scalar
    mean: Float[Array, "I"]
    deviation: Float[Array, "I"]


class TexturesState(NamedTuple):
    """A run under way; a pytree of arrays. a, b: turn the generator's output into a texture (natural_start.py); decoder,
    height: those of the exemplars, scaled; these four stay fixed. versus: None without a critic. images: rows seen."""

    generator: Generator
    smooth: Generator
    averages: Averages
    a: Float[Array, "W C"]
    b: Float[Array, "C"]
    adam: optax.OptState
    decoder: Decoder
    height: Float[Array, "R C"]
    versus: CriticState | None
    step: Int[Array, ""]
    images: Int[Array, ""]


class TexturesReport(NamedTuple):
    """error, height: unexplained shares of the variance, of features 0 with a critic; losses of generator and critic, mean
    logits, penalty without its weight, and γ, 0 without a critic; bad: which leaves of the gradients are not finite."""

    error: Scalar
    height: Scalar
    generator: Scalar
    critic: Scalar
    real: Scalar
    fake: Scalar
    penalty: Scalar
    gamma: Scalar
    bad: Bool[Array, "_leaves"]


def adapt(config: TexturesConfig, exemplars: Exemplars) -> tuple[TexturesConfig, ScaledExemplars]:
    """The configuration adapted to exemplars, and the exemplars scaled, and averaged if they have more texels a patch than the
    generator. A geometry parameter that all share is left out: it teaches nothing. Raises InputError if they are tiles, have
    other texels, or are fewer than the configuration needs."""
    exemplars.check_periodic()
    count = config.exemplars or len(exemplars.features)
    texels, channels = exemplars.features.shape[1] // exemplars.patches, exemplars.features.shape[3]
    coarser = texels // config.generator.texels
    if coarser * config.generator.texels != texels:
        raise InputError(exemplars.path, f"has {texels} texels a patch; the generator has {config.generator.texels}")
    if count > len(exemplars.features):
        raise InputError(exemplars.path, f"has {len(exemplars.features)} patches; the experiment needs {count}")
    if exemplars.patches > 1 and not config.adversarial:
        raise InputError(exemplars.path, "is a torus of many patches; the experiment needs each by itself")
    if config.adversarial and not grid_side(config.window):
        raise InputError(Argument("window"), f"{config.window} texels are less than the critic's {WINDOW}")
    some = scale_exemplars(
        _varied(replace(exemplars, features=exemplars.features[:count], beta=exemplars.beta[:count])), coarser
    )
    beta = [p for p in some.what.parameters if p.role == "beta"]
    betas, rows = len(beta), len(exemplars.height)
    generator = replace(config.generator, channels=channels, betas=betas, height_rows=rows)
    directions = tuple(i for i, p in enumerate(beta) if config.adversarial and _is_direction(p))
    about = {"octaves": exemplars.height_octaves, "alphas": some.alphas, "directions": directions}
    return replace(config, generator=generator, critic=replace(config.critic, betas=betas), **about), some


def _varied(exemplars: Exemplars) -> Exemplars:
    """Exemplars without the geometry parameters that are the same for all."""
    beta = [p for p in exemplars.parameters if p.role == "beta"]
    varies = np.ptp(exemplars.beta, axis=0) > 0
    fixed = [p for p, v in zip(beta, varies, strict=True) if not v]
    parameters = tuple(p for p in exemplars.parameters if p not in fixed)
    return replace(exemplars, beta=exemplars.beta[:, varies], parameters=parameters)


def _is_direction(parameter: Parameter) -> bool:
    """Whether a parameter is an angle that goes once around."""
    low, high = parameter.range
    return parameter.unit == "rad" and math.isclose(high - low, 2 * math.pi, rel_tol=1e-6)
