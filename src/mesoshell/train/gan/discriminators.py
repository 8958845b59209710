"""The discriminators that a run can use, behind one interface.

Notation
y       pictures as `step.seen` shows them                                        (B, S, S, 3 or 4)
f       what is judged of them: y, maps of a network that saw photographs, or both     a tree of (B, h, w, C)
c       labels                                                                    (B, L)
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from mesoshell.shell.generator import discriminator as residual
from mesoshell.shell.generator import projected, vision_aided
from mesoshell.shell.generator.discriminator import Discriminator, DiscriminatorConfig
from mesoshell.shell.generator.projected import Projected
from mesoshell.shell.generator.vision_aided import VisionAided

AnyDiscriminator = Discriminator | Projected | VisionAided


class Kind(NamedTuple):
    """start: (config, key) → weights; perceive: y → f; judge: (weights, f, c, everyone, dtype) → logits (B,) or (B, heads),
    greater for renders; penalties: config.pixel_gamma → R1's weight, over γ, at each of f; grouped: whether a row's logit
    depends on other rows; lite0: whether it knows EfficientNet-Lite0."""

    start: Callable[..., Any]
    perceive: Callable[[Any], Any]
    judge: Callable[..., Any]
    penalties: Callable[[float], tuple[float, ...]]
    grouped: bool
    lite0: bool


KINDS = {
    "residual": Kind(residual.init_discriminator, lambda y: y, residual.discriminate, lambda _: (1.0,), True, False),
    "projected": Kind(
        projected.init_projected, projected.project, projected.judge, lambda _: (1 / 4,) * 4, False, True
    ),
    "vision-aided": Kind(
        vision_aided.init_vision_aided, vision_aided.perceive, vision_aided.judge, vision_aided.penalties, True, True
    ),
}


def kind_of(config: DiscriminatorConfig) -> Kind:
    """The one that a configuration asks for."""
    return KINDS[config.kind]
