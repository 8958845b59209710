"""Ablation: the network gives the cosine at which rays begin to pass; opacity is a step of it. Data as for weave_silhouette."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.surface.step import SurfaceTrainConfig, surface_config


def variant(preset: GanConfig) -> SurfaceTrainConfig:
    made = surface_config(preset)
    return replace(made, surface=replace(made.surface, opacity="cosine"))


config = variant(SMALL)
