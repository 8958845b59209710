"""Ablation: the maps' phases are the same for all textures: nothing is seen beyond one patch (MesoGAN, figure 14)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return replace(preset, generator=replace(preset.generator, fourier="frozen"))


config = variant(SMALL)
