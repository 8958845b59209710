"""Comparison: three orthogonal planes, as EG3D has them, in place of a plane and a height feature (MesoGAN, section 6.2).

They end where the patch does: a surface is broken into patches, each turned at random, with planes of its own.
`benchmarks/triplane.py` renders one so.
"""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return replace(preset, generator=replace(preset.generator, planes=3))


config = variant(SMALL)
