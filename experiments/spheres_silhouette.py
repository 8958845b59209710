"""A surface material of spheres that knows curvature: mesoshell dataset render-patches spheres --out data/spheres"""

from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.surface.step import SurfaceTraining, surface_as


def variant(preset: TrainConfig) -> SurfaceTraining:
    return surface_as(preset)


config = SurfaceTraining()
