"""Comparison: NeRF-Tex, one network fitted to renders, of the dataset's parameters (MesoGAN, section 6.3, figure 13).

It learns one patch by heart, so every image must show that patch: mesoshell dataset render carpet2 --patch 0 --count … --out …
`carpet.py` is ours, on a dataset without --patch.
"""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.nerf_tex.network import NerfTexConfig, nerf_tex_config


def variant(preset: GanConfig) -> NerfTexConfig:
    return nerf_tex_config(preset)


config = variant(SMALL)
