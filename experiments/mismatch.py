"""The discriminator is also told that a render is not one of other parameters. Data as for carpet."""

from dataclasses import replace

from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return replace(preset, mismatch=1.0)


config = variant(SMALL)
