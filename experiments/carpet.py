"""Carpet: length, lean, lean angle, roughness and braiding are geometry; hue and saturation are appearance."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
