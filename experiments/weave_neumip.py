"""Ablation: neither curvature nor opacity, a material of the flat plane (NeuMIP). Data as for weave_silhouette."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.surface.step import SurfaceTrainConfig, surface_config


def variant(preset: GanConfig) -> SurfaceTrainConfig:
    made = surface_config(preset)
    return replace(made, surface=replace(made.surface, opacity="none", curvature=False))


config = variant(SMALL)
