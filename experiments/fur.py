"""Fur: length and roughness are geometry; hue, saturation and value are appearance."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return preset


config = variant(SMALL)
