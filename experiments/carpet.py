"""Carpet: length, lean, lean angle, roughness and braiding are geometry; hue and saturation are appearance.

With the datasets carpet2, carpet4, carpet6 and carpet8, as many parameters (MesoGAN, figure 13, beside `nerf_tex.py`).
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return preset


config = variant(SMALL)
