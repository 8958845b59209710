"""Samples on a ray where light is expected to be lost, by the σ grid; a ray is walked once (shell/render/spacing).

Notation
S           samples on a ray straight through a shell, at most
segment     the part of a piece in one cell of the σ grid; ℓ: its canonical length
b, e        the largest σ in that cell; optical depth expected in a segment, EXPECTED · b · ℓ
T           transmittance expected before a segment, exp(−Σ e) of those before
c           samples so far: it grows along a segment, evenly, by S times
            LOST_SHARE T (1 − e^{−e}) + OCCUPIED_SHARE (1 − e^{−b}) ℓ + ℓ / WIDEST. A sample lies
            wherever c + shift passes a whole number, and stands for dℓ/dc

c does not depend on the shift: over evenly drawn ones the estimate of optical depth has no bias, whatever the grid holds,
but for what `Quality.skip` leaves out.
What a ray's whole length is need not be known, as LOST_SHARE is spent but once on any ray, and what ends a ray is matter.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.samples import IntervalFrame, canonical_frame, no_frame, nothing, sample_at
from mesoshell.pathtracer.traversal import OVER, Walker, advance, at_start
from mesoshell.render.quality import EXPECTED, LOST_SHARE, OCCUPIED_SHARE, WIDEST

#: A segment is at least this share of a cell, and this share of its piece: the next border of a cell may be lost in rounding.
MIN_SEGMENT, MIN_SHARE = 0.01, 2.0**-12


@dataclass
class DensitySampling:
    """State of a ray's sampling. f, end: how far the piece has been searched, and where its segment ends; rate: dc/df there;
    expected: Σ e; until: growth of c to the next sample; step: canonical length that the last one stands for."""

    walker: Walker
    frame: IntervalFrame
    f: mi.Float
    end: mi.Float
    rate: mi.Float
    expected: mi.Float
    until: mi.Float
    step: mi.Float
    over: mi.Bool


def begin(ray, shift) -> DensitySampling:
    """A ray at its start. shift: in [0, 1)."""
    n = dr.width(ray.start)
    one, zero = dr.full(mi.Float, 1, n), dr.zeros(mi.Float, n)
    return DensitySampling(
        at_start(ray.start, ray.outside),
        no_frame(),
        one,
        mi.Float(one),
        zero,
        mi.Float(zero),
        1 - (mi.Float(shift) + zero),
        mi.Float(zero),
        mi.Bool(False),
    )


@dr.syntax
def seek(context, ray, s):
    """The state after the next sample that may not be empty, that sample, and whether there is one."""
    shells, media, taps = context.shells, context.media, context.taps
    count, skip = context.quality.samples, context.quality.skip
    occupied, sample = mi.Bool(False), nothing()
    while ~occupied & ~s.over:
        if (s.f >= s.end) & (s.end < 1):
            s = _next_segment(context, ray, s)
        if s.f < s.end:
            more = s.rate * (s.end - s.f)
            if s.until < more:
                s.f = dr.minimum(s.f + s.until / s.rate, s.end)
                s.until = mi.Float(1)
                share = 1 / s.rate
                s.step = share * s.frame.length
                sample = sample_at(context, ray, s.frame, s.f, share)
                occupied = media.bound(sample, taps) * s.step * count > skip
            else:
                s.until -= more
                s.f = mi.Float(s.end)
        else:
            walker, piece, some = advance(shells, ray.o, ray.d, ray.tmax, s.walker)
            s.walker = walker
            if some:
                s.frame = canonical_frame(shells, piece, context.exact)
                s.f = dr.select(s.frame.length > 0, mi.Float(0), 1)
                s.end = mi.Float(s.f)
            elif s.walker.mode == OVER:
                s.over = mi.Bool(True)
    return s, sample, occupied


def _next_segment(context, ray, s: DensitySampling) -> DensitySampling:
    """The state at the beginning of the next cell of the σ grid."""
    frame, count = s.frame, context.quality.samples
    at = sample_at(context, ray, frame, s.f, 0.0)
    along: Any = frame.xi1 - frame.xi0
    at.xi = frame.xi0 + s.f * along
    cells = context.media.cells(at, context.taps)
    way, place = along * cells, at.xi * cells
    ahead = dr.select(way < 0, -place, place)
    speed = dr.abs(way)
    left = dr.select(speed > 0, (dr.floor(ahead) + 1 - ahead) / dr.select(speed > 0, speed, 1), 1)
    least = dr.maximum(MIN_SEGMENT / dr.maximum(dr.max(speed), MIN_SEGMENT), MIN_SHARE)
    end = dr.minimum(s.f + dr.maximum(dr.min(left), least), 1)
    at.xi = frame.xi0 + 0.5 * (s.f + end) * along
    bound = context.media.bound(at, context.taps)
    length = (end - s.f) * frame.length
    lost = dr.exp(-s.expected) * _opacity(EXPECTED * bound * length)
    samples = count * (LOST_SHARE * lost + (OCCUPIED_SHARE * _opacity(bound) + 1 / WIDEST) * length)
    rate = samples / dr.maximum(end - s.f, 1e-9)
    expected = s.expected + EXPECTED * bound * length
    return DensitySampling(s.walker, frame, s.f, end, rate, expected, s.until, s.step, s.over)


def _opacity(depth):
    return 1 - dr.exp(-depth)
