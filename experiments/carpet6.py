"""Carpet of 6 parameters, to be compared with NeRF-Tex on as many (MesoGAN, figure 13).

Geometry: length, lean, lean angle and roughness. Appearance: hue and saturation.
Every image shows another geometry: mesoshell dataset render carpet6 --count … --out …
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig

recipe = "carpet6"


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
