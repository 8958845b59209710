"""An object from its photographs, encoded as in the paper: sines and cosines of places instead of hash grids."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    return neutex_config(preset, "frequency")


config = variant(SMALL)
