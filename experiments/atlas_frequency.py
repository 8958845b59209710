"""An object from its photographs, encoded as in the paper: sines and cosines of places instead of hash grids."""

from mesoshell.train.atlas import AtlasTraining, atlas_as
from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> AtlasTraining:
    return atlas_as(preset, "frequency")


config = variant(SMALL)
