"""Samples on a ray in proportion to canonical length (shell/geometry/sampling).

Notation
ℓ           canonical length of a piece; L: of all of a ray's pieces; N samples stand for L/N each

A ray is walked twice: L is measured first.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.samples import IntervalFrame, canonical_frame, no_frame, nothing, sample_at
from mesoshell.pathtracer.traversal import OVER, Walker, advance, at_start


@dataclass
class LengthSampling:
    """State of a ray's sampling. begin: canonical length before the piece; k: number of the next sample, which lies
    `shift` of a step after k steps; step: L/N."""

    walker: Walker
    frame: IntervalFrame
    measuring: mi.Bool
    begin: mi.Float64
    total: mi.Float64
    step: mi.Float64
    k: mi.UInt32
    shift: mi.Float
    over: mi.Bool


def begin(ray, shift) -> LengthSampling:
    """A ray at its start. shift: in [0, 1)."""
    n = dr.width(ray.start)
    zero = dr.zeros(mi.Float64, n)
    return LengthSampling(
        at_start(ray.start, ray.outside),
        no_frame(),
        mi.Bool(True),
        zero,
        mi.Float64(zero),
        mi.Float64(zero),
        dr.zeros(mi.UInt32, n),
        mi.Float(shift) + dr.zeros(mi.Float, n),
        mi.Bool(False),
    )


@dr.syntax
def seek(context, ray, s):
    """The state after the next sample that may not be empty, that sample, and whether there is one."""
    shells, count, skip = context.shells, context.quality.samples, context.quality.skip
    occupied, sample = mi.Bool(False), nothing()
    while ~occupied & ~s.over:
        position = (mi.Float64(s.k) + mi.Float64(s.shift)) * s.step
        length = mi.Float64(s.frame.length)
        if ~s.measuring & (s.k < count) & (position < s.begin + length):
            sample = sample_at(
                context, ray, s.frame, mi.Float((position - s.begin) / length), mi.Float(s.step / length)
            )
            occupied = context.media.bound(sample, context.taps) * mi.Float(s.total) > skip
            s.k += 1
        else:
            walker, piece, some = advance(shells, ray.o, ray.d, ray.tmax, s.walker)
            s.walker = walker
            if some:
                s.begin += length
                s.frame = canonical_frame(shells, piece, context.exact)
            elif s.walker.mode == OVER:
                if s.measuring:
                    s.measuring = mi.Bool(False)
                    s.total = s.begin + length
                    s.step = s.total / count
                    s.over = s.total <= 0
                    s.begin = mi.Float64(0)
                    s.frame = no_frame()
                    s.walker = at_start(ray.start, ray.outside)
                else:
                    s.over = mi.Bool(True)
    return s, sample, occupied
