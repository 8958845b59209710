"""From fitted patches (mesoshell fit): the generator learns their textures by regression, each at phases of its own."""

from mesoshell.train.gan.state import GanConfig
from mesoshell.train.textures.state import TexturesConfig, textures_config


def variant(preset: GanConfig) -> TexturesConfig:
    return textures_config(preset)


config = TexturesConfig()
