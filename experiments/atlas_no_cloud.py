"""What a point cloud is for: the inverse map begins as a sphere, and follows the surface by its cycle loss alone."""

from dataclasses import replace

from mesoshell.train.atlas import AtlasTraining, atlas_as
from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> AtlasTraining:
    return replace(atlas_as(preset), chamfer=0.0)


config = variant(SMALL)
