"""Ablation: features are looked up at their finest level from everywhere. Far views alias (MesoGAN, figure 9 and table 3)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return replace(preset, picture=replace(preset.picture, filtering=False))


config = variant(SMALL)
