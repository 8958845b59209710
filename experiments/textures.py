"""From fitted patches (mesoshell fit): the generator learns their textures by regression, each at phases of its own."""

from mesoshell.train.state import TrainConfig
from mesoshell.train.textures_state import TexturesConfig, textures_as


def variant(preset: TrainConfig) -> TexturesConfig:
    return textures_as(preset)


config = TexturesConfig()
