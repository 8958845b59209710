"""What a texture costs: a NeRF of the same size and budget, by the same code. Colours come from the volume; no map, no
cycle, nothing that can be painted on."""

from dataclasses import replace

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.neutex.step import NeuTexTrainConfig, neutex_config


def variant(preset: GanConfig) -> NeuTexTrainConfig:
    config = neutex_config(preset)
    return replace(config, field=replace(config.field, colour="volume"), chamfer=0.0, finish=0.0)


config = variant(SMALL)
