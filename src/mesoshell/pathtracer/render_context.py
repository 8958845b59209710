"""The shells and surface materials of a scene, as integrators hold them.

Not a dataclass: Dr.Jit would treat its fields as loop state.
"""

import math

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.samples import Ray
from mesoshell.render.camera import pixel_radius

#: Radius of a pixel's cone over the distance of neighbouring pixels' rays.
RADIUS = pixel_radius(1.0)
#: Spread of the cones of a camera whose rays are parallel: they are as wide as a pixel everywhere, or nearly so.
PARALLEL = 1e-6


class RenderContext:
    """shells, and media, their contents, or None; surface_meshes: with surface materials, or None; quality: render/quality;
    effects: render/effects; extent: greatest side of all that stands in the scene; notes: how all this departs from the
    request; facts: what the effects were planned from. It must not hold the user's scene: the scene holds the integrator,
    which holds this, and such a cycle would never be collected."""

    def __init__(self, shells, media, surface_meshes, quality, effects, extent=1.0, notes=(), facts=None):
        self.shells, self.media, self.surface_meshes = shells, media, surface_meshes
        self.quality, self.effects, self.notes = quality, effects, notes
        self.extent, self.facts = dr.opaque(mi.Float, extent), facts
        self._queries = dr.zeros(mi.Float64, 1)

    def bake(self) -> None:
        """Make what paths read in place of the network, if they do and it is not there yet: before the first of them."""
        if self.effects.baked_density.on and self.media is not None:
            self.media.bake()

    @property
    def taps(self) -> int:
        """Taps of the filter along a footprint; 0 without filtering."""
        if not self.effects.filtering.on:
            return 0
        return self.quality.anisotropy if self.effects.anisotropic_filtering.on else 1

    @property
    def exact(self) -> bool:
        """Whether coordinates invert the prism's map."""
        return self.quality.coordinates == "exact"

    @property
    def dark(self) -> float:
        """The optical depth at which a ray ends."""
        return -math.log(self.quality.early_stop) if self.quality.early_stop > 0 else math.inf

    @property
    def surfaces_shadow(self) -> bool:
        """Whether a surface of the scene may block a light."""
        return self.effects.mesh_shadow.on or self.effects.object_shadow.on

    def count(self, queries) -> None:
        """Add to the number of evaluated samples."""
        dr.scatter_add(self._queries, mi.Float64(queries), mi.UInt32(0))

    @property
    def queries(self) -> int:
        """Samples evaluated in all pictures so far."""
        return int(self._queries[0])

    def camera_ray(self, ray, sampler) -> Ray:
        """A camera's ray with the cone of a pixel: Mitsuba's differentials are those of a sample, √count times narrower."""
        n = dr.width(ray.o)
        spread, radius = (
            RADIUS * dr.norm(x) * sampler.sample_count() ** 0.5 for x in (ray.d_x - ray.d, ray.o_x - ray.o)
        )
        spread = dr.maximum(spread, dr.select(radius > 0, PARALLEL, 0))
        return Ray(
            mi.Vector3d(ray.o),
            mi.Vector3d(ray.d),
            dr.zeros(mi.Float64, n),
            dr.full(mi.Float64, dr.inf, n),
            dr.full(mi.Bool, not self.effects.camera_in_shell.on, n),
            spread,
            dr.select(spread > 0, radius / dr.select(spread > 0, spread, 1), 0),
        )
