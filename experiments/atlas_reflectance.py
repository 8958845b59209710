"""An object that can be lit anew: what its surface is made of, from photographs whose only light was the camera's
(mesoshell atlas capture --flash)."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    config = neutex_config(preset)
    return replace(config, field=replace(config.field, colour="reflectance"))


config = variant(SMALL)
