"""A combed carpet, small enough for an hour on two cores: lean, length and roughness stay as rendered, the lean angle varies."""

from mesoshell.shell.discriminator import DiscriminatorConfig
from mesoshell.shell.plan import GeneratorConfig
from mesoshell.train.picture import PictureConfig
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = TrainConfig(
    generator=GeneratorConfig(
        texels=32, channel_base=1024, channel_max=64, layers=6, waves=16, drift=1.5, z=32, w=32, height_rows=32
    ),
    discriminator=DiscriminatorConfig(size=32, channel_base=2048, channel_max=128),
    picture=PictureConfig(size=32, samples=24, texels=32, height_rows=32),
    views=2,
    near_kimg=2.0,
    gamma=0.125,
    snapshot_kimg=4.0,
)
