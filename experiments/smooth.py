"""The two helps of public 3D-aware GANs: early pictures are blurred, and density must not jump. Do they help here?"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    blur = 10 * preset.picture.size / 512
    return replace(preset, blur=blur, blur_kimg=preset.near_kimg, density=0.25)


config = variant(SMALL)
