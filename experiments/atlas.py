"""An object from its photographs, with a texture that it discovers itself (NeuTex). Encoded by hash grids, or
at `--preset paper` by the paper's sines and cosines, which atlas_frequency has at any."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.neutex.step import AtlasTraining, atlas_as


def variant(preset: TrainConfig) -> AtlasTraining:
    return atlas_as(preset)


config = variant(SMALL)
