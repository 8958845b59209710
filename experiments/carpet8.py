"""Carpet of 8 parameters, to be compared with NeRF-Tex on as many (MesoGAN, figure 13).

Geometry: length, lean, lean angle, roughness, braiding and density. Appearance: hue and saturation.
Every image shows another geometry: mesoshell dataset render carpet8 --count … --out …
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig

recipe = "carpet8"


def variant(preset: TrainConfig) -> TrainConfig:
    return preset


config = variant(SMALL)
