"""Carpet of 4 parameters, to be compared with NeRF-Tex on as many (MesoGAN, figure 13).

Geometry: length, lean and lean angle. Appearance: hue.
Every image shows another geometry: mesoshell dataset render carpet4 --count … --out …
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig

recipe = "carpet4"


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
