"""Fur: length and roughness are geometry; hue, saturation and value are appearance."""

from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
