"""Ablation: no Fourier maps but the input's. A layer has no waves of its own band to shape (MesoGAN, table 3).

Its data are those of what it is compared with: the paper's is the carpet of 8 parameters.
"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return replace(preset, generator=replace(preset.generator, fourier="off"))


config = variant(SMALL)
