"""The discriminator is also told that a render is not one of other parameters. Data as for carpet."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return replace(preset, mismatch=1.0)


config = variant(SMALL)
