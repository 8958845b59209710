"""Ablation: the network gives the cosine at which rays begin to pass; opacity is a step of it. Data as for weave_silhouette."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.surface.step import SurfaceTraining, surface_as


def variant(preset: TrainConfig) -> SurfaceTraining:
    made = surface_as(preset)
    return replace(made, surface=replace(made.surface, opacity="cosine"))


config = variant(SMALL)
