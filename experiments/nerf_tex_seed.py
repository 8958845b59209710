"""Comparison: NeRF-Tex told the seed of every image's geometry as one more parameter (MesoGAN, figure 13, last column).

Any dataset whose images show a geometry each, so without --patch; the paper's is the carpet of 8 parameters. Can a network
learn them all by heart, and what does it make of a seed between those that it has seen?
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.nerf_tex.network import ParametricConfig, sized_as


def variant(preset: TrainConfig) -> ParametricConfig:
    return sized_as(preset, seeded=True)


config = variant(SMALL)
