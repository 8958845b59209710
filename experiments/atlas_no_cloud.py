"""What a point cloud is for: the inverse map begins as a sphere, and follows the surface by its cycle loss alone."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    return replace(neutex_config(preset), chamfer=0.0)


config = variant(SMALL)
