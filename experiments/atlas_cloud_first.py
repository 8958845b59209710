"""The maps learn from the cloud alone at first, for a quarter of the run; then cycle and masks take its place (NeuTex,
section 4.2, figure 7)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    return replace(neutex_config(preset), alone=True, chamfer=0.25)


config = variant(SMALL)
