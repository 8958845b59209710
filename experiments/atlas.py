"""An object from its photographs, with a texture that it discovers itself (NeuTex). Encoded by hash grids, or
at `--preset paper` by the paper's sines and cosines, which atlas_frequency has at any."""

from mesoshell.train.atlas import AtlasTraining, atlas_as
from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> AtlasTraining:
    return atlas_as(preset)


config = variant(SMALL)
