"""A surface material of spheres that knows curvature: mesoshell dataset render-patches spheres --out data/spheres"""

from mesoshell.train.gan.state import GanConfig
from mesoshell.train.surface.step import SurfaceTrainConfig, surface_config


def variant(preset: GanConfig) -> SurfaceTrainConfig:
    return surface_config(preset)


config = SurfaceTrainConfig()
