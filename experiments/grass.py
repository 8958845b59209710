"""Grass: the method as it is. The age parameter is appearance; geometry varies with the seed alone."""

from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig


def variant(preset: GanConfig) -> GanConfig:
    return preset


config = variant(SMALL)
