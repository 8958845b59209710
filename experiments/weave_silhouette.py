"""A surface material of woven yarns that knows curvature: mesoshell dataset render-patches weave --out data/weave"""

from mesoshell.train.gan.state import GanConfig
from mesoshell.train.surface.step import SurfaceTrainConfig, surface_config


def variant(preset: GanConfig) -> SurfaceTrainConfig:
    return surface_config(preset)


config = SurfaceTrainConfig()
