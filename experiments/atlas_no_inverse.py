"""What the inverse map is for: without it and its cycle loss nothing keeps parts of the surface from sharing one place in the
texture (the paper's figure 3)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.neutex.step import AtlasTraining, atlas_as


def variant(preset: TrainConfig) -> AtlasTraining:
    return replace(atlas_as(preset), cycle=0.0, chamfer=0.0)


config = variant(SMALL)
