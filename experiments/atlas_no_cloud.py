"""What a point cloud is for: the inverse map begins as a sphere, and follows the surface by its cycle loss alone."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.neutex.step import AtlasTraining, atlas_as


def variant(preset: TrainConfig) -> AtlasTraining:
    return replace(atlas_as(preset), chamfer=0.0)


config = variant(SMALL)
