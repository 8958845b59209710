"""Fur: length and roughness are geometry; hue, saturation and value are appearance."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
