"""An object from its photographs, with a texture that it discovers itself (NeuTex). Encoded by hash grids, or
at `--preset paper` by the paper's sines and cosines, which atlas_frequency has at any."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    return neutex_config(preset)


config = variant(SMALL)
