"""Comparison: NeRF-Tex told the seed of every image's geometry as one more parameter (MesoGAN, figure 13, last column).

Any dataset whose images show a geometry each, so without --patch; the paper's is the carpet of 8 parameters. Can a network
learn them all by heart, and what does it make of a seed between those that it has seen?
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.nerf_tex.network import NerfTexConfig, nerf_tex_config


def variant(preset: GanConfig) -> NerfTexConfig:
    return nerf_tex_config(preset, seeded=True)


config = variant(SMALL)
