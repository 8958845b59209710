"""A run on textures: its configuration, its state, its report of a step.

Notation
γ           of the critic's penalty γ/2 mean (D(y + ε n) − D(y))²/ε², on both sides, n normal
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import optax

from mesoshell.errors import InputError
from mesoshell.io.exemplars import Exemplars
from mesoshell.shell.generator.generator import Averages, Generator
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import Critic, CriticConfig, grid_side
from mesoshell.shell.material.decoder import Decoder
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.textures.critic_view import CHANNELS
from mesoshell.train.textures.exemplars import ScaledExemplars, scaled
from mesoshell.typing import Array, Bool, Float, Int, Scalar


@dataclass(frozen=True)
class TexturesConfig:
    """Everything that a run depends on beside the exemplars. batch: B; kimg: thousands of rows; rate: Adam's, which falls along
    a cosine to `final` of itself; exemplars: how many of them, from the first on, 0 for all. adversarial, anchor: weights of
    the critic's loss and of the regression; critic_rate, gamma: of the critic; warm: first steps, in which only it learns.
    octaves: of the decoder, and alphas: its appearance parameters, which follow from the exemplars."""

    generator: GeneratorConfig = field(
        default_factory=lambda: GeneratorConfig(layers=7, channel_base=8192, waves=8, drift=1.5, z=0, texels=128)
    )
    critic: CriticConfig = field(default_factory=lambda: CriticConfig(CHANNELS))
    batch: int = 2
    kimg: float = 8.0
    rate: float = 3e-2
    final: float = 0.1
    exemplars: int = 0
    adversarial: float = 0.0
    anchor: float = 1.0
    critic_rate: float = 5e-3
    gamma: float = 1.0
    warm: int = 20
    octaves: int = 4
    alphas: int = 0
    snapshot_kimg: float = 0.5
    seed: int = 0


def textures_as(preset: TrainConfig) -> TexturesConfig:
    """A run at a preset's size: twice its texels a patch, 64 at least, with its channels. `tiny` is over in minutes."""
    texels, most = max(64, 2 * preset.generator.texels), preset.generator.channel_max
    config = TexturesConfig()
    generator = replace(config.generator, texels=texels, channel_base=most * texels, channel_max=most)
    return replace(config, generator=generator, kimg=0.04 if most < 64 else config.kimg)


class CriticState(NamedTuple):
    """The critic, its optimiser, and mean and deviation of its views of exemplars, which stay fixed."""

    critic: Critic
    adam: optax.OptState
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


class CriticReport(NamedTuple):
    """A critic's update: its loss without the penalty, mean logits, and the penalty without γ/2."""

    critic: Scalar
    real: Scalar
    fake: Scalar
    penalty: Scalar


class TexturesReport(NamedTuple):
    """error, height: unexplained shares of the variance; losses of generator and critic, mean logits and penalty (without γ/2),
    0 without a critic; bad: which leaves of the gradients are not finite."""

    error: Scalar
    height: Scalar
    generator: Scalar
    critic: Scalar
    real: Scalar
    fake: Scalar
    penalty: Scalar
    bad: Bool[Array, "_leaves"]


def fitted(config: TexturesConfig, exemplars: Exemplars) -> tuple[TexturesConfig, ScaledExemplars]:
    """The configuration adapted to exemplars, and the exemplars scaled. Raises InputError if they are tiles, have another
    number of texels than the generator, or are fewer than the configuration needs."""
    exemplars.check_periodic()
    count = config.exemplars or len(exemplars.features)
    side, channels = exemplars.features.shape[1], exemplars.features.shape[3]
    if side != config.generator.texels:
        raise InputError(exemplars.path, f"has {side} texels a patch; the generator has {config.generator.texels}")
    if count > len(exemplars.features):
        raise InputError(exemplars.path, f"has {len(exemplars.features)} patches; the experiment needs {count}")
    if config.adversarial and not grid_side(side):
        raise InputError(exemplars.path, f"has {side} texels a patch, which is less than a critic's window")
    some = scaled(replace(exemplars, features=exemplars.features[:count], beta=exemplars.beta[:count]))
    betas, rows = exemplars.beta.shape[1], len(exemplars.height)
    generator = replace(config.generator, channels=channels, betas=betas, height_rows=rows)
    about = {"octaves": exemplars.height_octaves, "alphas": some.alphas}
    return replace(config, generator=generator, critic=replace(config.critic, betas=betas), **about), some
