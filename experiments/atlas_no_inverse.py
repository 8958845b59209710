"""What the inverse map is for: without it and its cycle loss nothing keeps parts of the surface from sharing one place in the
texture (the paper's figure 3)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    return replace(neutex_config(preset), cycle=0.0, chamfer=0.0)


config = variant(SMALL)
