"""What the inverse map is for: without it and its cycle loss nothing keeps parts of the surface from sharing one place in the
texture (the paper's figure 3)."""

from dataclasses import replace

from mesoshell.train.atlas import AtlasTraining, atlas_as
from mesoshell.train.presets import SMALL
from mesoshell.train.state import TrainConfig


def variant(preset: TrainConfig) -> AtlasTraining:
    return replace(atlas_as(preset), cycle=0.0, chamfer=0.0)


config = variant(SMALL)
