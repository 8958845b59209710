"""An object that can be lit anew: what its surface is made of, from photographs whose only light was the camera's
(mesoshell atlas capture --flash)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.neutex.step import AtlasTraining, atlas_as


def variant(preset: TrainConfig) -> AtlasTraining:
    config = atlas_as(preset)
    return replace(config, field=replace(config.field, colour="reflectance"))


config = variant(SMALL)
