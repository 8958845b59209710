"""The integrator of a scene with shells: paths, or sums where those are enough."""

from typing import Any

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.direct import light_directly
from mesoshell.pathtracer.paths import advance, begin, busy

#: Segments of a path without a bound.
MAX_DEPTH = 2**31


class ShellPath(mi.SamplingIntegrator):
    """`mesoshell_path`: max_depth, rr_depth and hide_emitters as of Mitsuba's `path`; hide_lamps: rays pass emitters that have
    an extent, as in Blender: they give light, and are neither seen nor in its way. context: set by pathtracer/load."""

    def __init__(self, props):
        super().__init__(props)
        depth = int(props.get("max_depth", -1))
        self.max_depth = MAX_DEPTH if depth < 0 else min(depth, MAX_DEPTH)
        self.rr_depth = min(max(int(props.get("rr_depth", 5)), 0), MAX_DEPTH)
        self.hide_emitters = bool(props.get("hide_emitters", False))
        self.hide_lamps = bool(props.get("hide_lamps", False))
        self.context: Any = None

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance toward rays, and whether they met anything."""
        self.context.bake()
        camera = self.context.camera_ray(ray, sampler)
        if self.context.effects.quadrature.on:
            return *light_directly(self, scene, sampler, camera, active), []
        return *follow(self, scene, sampler, camera, active), []

    def to_string(self):
        return f"ShellPath[max_depth={self.max_depth}, rr_depth={self.rr_depth}]"


@dr.syntax
def follow(settings, scene, sampler, ray, active):
    """Radiance toward camera rays by a path for each, and whether they met anything. settings: a ShellPath."""
    lane = begin(settings, scene, ray, active)
    while busy(lane):
        lane = advance(settings, scene, sampler, lane)
    settings.context.count(lane.queries)
    return lane.light, lane.valid


def register() -> None:
    """Make Mitsuba know the integrator `mesoshell_path`."""
    mi.register_integrator("mesoshell_path", ShellPath)
