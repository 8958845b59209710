"""The discriminator is also told that a render is not one of other parameters. Data as for carpet."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return replace(preset, mismatch=1.0)


config = variant(SMALL)
