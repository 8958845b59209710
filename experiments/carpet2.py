"""Carpet of 2 parameters, to be compared with NeRF-Tex on as many (MesoGAN, figure 13).

Geometry: length. Appearance: hue.
Every image shows another geometry: mesoshell dataset render carpet2 --count … --out …
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig

recipe = "carpet2"


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
