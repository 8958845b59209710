"""An object from its photographs, encoded as in the paper: sines and cosines of places instead of hash grids."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.neutex.step import AtlasTraining, atlas_as


def variant(preset: TrainConfig) -> AtlasTraining:
    return atlas_as(preset, "frequency")


config = variant(SMALL)
