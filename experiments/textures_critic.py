"""From fitted patches, against a critic: textures of new phases are told from exemplars, whose regression is the anchor.

Begin with the weights of a run of textures.py (--transfer): from a natural start the critic leads at once.
"""

from dataclasses import replace

from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.textures.state import TexturesConfig, textures_as


def variant(preset: TrainConfig) -> TexturesConfig:
    return replace(textures_as(preset), adversarial=1.0, rate=1e-3)


config = replace(TexturesConfig(), adversarial=1.0, rate=1e-3)
