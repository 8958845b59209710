"""From fitted patches (mesoshell fit): the generator learns their textures by regression, each at phases of its own."""

from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.textures.state import TexturesConfig, textures_as


def variant(preset: TrainConfig) -> TexturesConfig:
    return textures_as(preset)


config = TexturesConfig()
