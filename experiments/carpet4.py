"""Carpet of 4 parameters, to be compared with NeRF-Tex on as many (MesoGAN, figure 13).

Geometry: length, lean and lean angle. Appearance: hue.
Every image shows another geometry: mesoshell dataset render carpet4 --count … --out …
"""

from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig

recipe = "carpet4"


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
