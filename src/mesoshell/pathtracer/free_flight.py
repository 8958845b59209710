"""A ray's flight through all shells: to a collision, or out again with a transmittance.

Notation
τ           optical depth so far
target      −log(1 − ξ): the flight ends where τ passes it, with density T σ |J⁻¹ d| over the samples of the ray; infinite for a
            ray that only needs its transmittance

The samples are those of the quadrature (pathtracer/quadrature): a collision is drawn at one of them with exactly the weight
that `direct` gives it. So both have the same mean, unless σ is read from a grid here.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.quadrature import begin, seek
from mesoshell.pathtracer.samples import IntervalFrame, Sample, no_frame, nothing


@dataclass
class Flight:
    """τ at the end, summed in float64, as float32 would lose digits over thousands of samples; whether there was a collision,
    its sample and its piece's frame."""

    depth: mi.Float64
    collided: mi.Bool
    sample: Sample
    frame: IntervalFrame
    queries: mi.UInt32


def still(n: int) -> Flight:
    """The flight of rays where there are no shells."""
    return Flight(dr.zeros(mi.Float64, n), dr.full(mi.Bool, False, n), nothing(), no_frame(), dr.zeros(mi.UInt32, n))


@dr.syntax
def fly(context, ray, target, active, shift: Any = 0.5):
    """The flight of active rays; the others end at once."""
    s = begin(context, ray, shift)
    s.over = ~active
    n = dr.width(ray.o)
    end, baked = still(n), context.effects.baked_density.on
    busy = mi.Bool(active)
    while busy:
        s, sample, occupied = seek(context, ray, s)
        busy = occupied
        if occupied:
            sigma = context.media.sigma(sample, context.taps, baked)
            end.depth += mi.Float64(dr.minimum(sigma, 1e20) * mi.Float(s.step))
            end.queries += 0 if baked else 1
            if end.depth >= target:
                end.queries += 1 if baked else 0  # the network is asked where light is scattered
                end.collided = mi.Bool(True)
                end.sample = sample
                end.frame = s.frame
                busy = mi.Bool(False)
    return end
