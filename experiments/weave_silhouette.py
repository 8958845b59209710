"""A surface material of woven yarns that knows curvature: mesoshell dataset render-patches weave --out data/weave"""

from mesoshell.train.gan.state import TrainConfig
from mesoshell.train.surface.step import SurfaceTraining, surface_as


def variant(preset: TrainConfig) -> SurfaceTraining:
    return surface_as(preset)


config = SurfaceTraining()
