"""Ablation: neither curvature nor opacity, a material of the flat plane (NeuMIP). Data as for weave_silhouette."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.surface.step import SurfaceTraining, surface_as


def variant(preset: TrainConfig) -> SurfaceTraining:
    made = surface_as(preset)
    return replace(made, surface=replace(made.surface, opacity="none", curvature=False))


config = variant(SMALL)
