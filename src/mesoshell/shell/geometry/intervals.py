"""Intervals of rays, cut and put in order.

Notation
t0, t1      where an interval begins and ends along its ray                           world
visit       the intervals of one walk of a ray through the shell: they follow each other
"""

import numpy as np
from jaxtyping import Float

from mesoshell.shell.geometry.batched_walk import Intervals, no_intervals


def cut(i: Intervals, begin: Float[np.ndarray, "I"], end: Float[np.ndarray, "I"] | float = np.inf) -> Intervals:
    """The parts of intervals between `begin` and `end`, λ and h interpolated there; empty ones are dropped."""
    t0, t1 = np.maximum(i.t0, begin), np.minimum(i.t1, end)
    kept = t1 > t0
    i, t0, t1 = Intervals(*(x[kept] for x in i)), t0[kept], t1[kept]
    first, last = (((t - i.t0) / (i.t1 - i.t0)).astype(i.h0.dtype) for t in (t0, t1))

    def at(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bary = (1 - share)[:, None] * i.bary0 + share[:, None] * i.bary1
        return bary, (1 - share) * i.h0 + share * i.h1

    (bary0, h0), (bary1, h1) = at(first), at(last)
    return Intervals(i.ray, i.prism, t0, t1, bary0, bary1, h0, h1)


def without_overlap(parts: list[Intervals]) -> Intervals:
    """Sorted by ray and visit, each cut to begin no earlier than all before it on the same ray have ended. In a part each ray
    has one visit at most."""
    if not parts:
        return no_intervals()
    i = Intervals(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    if not len(i.ray):
        return i
    begin = np.concatenate([_first(part)[part.ray] for part in parts])
    order = np.lexsort((i.t0, begin, i.ray))
    i = Intervals(*(x[order] for x in i))
    span = 2 * (np.abs(i.t1).max() + 1)
    reached = np.maximum.accumulate(i.t1 + span * i.ray) - span * i.ray
    before = np.concatenate([[-np.inf], reached[:-1]])
    before[np.concatenate([[True], i.ray[1:] != i.ray[:-1]])] = -np.inf
    overlaps = before > i.t0 + 1e-9 * span
    return cut(i, np.where(overlaps, before, i.t0))


def _first(part: Intervals) -> Float[np.ndarray, "R"]:
    """Where each ray's visit begins."""
    begin = np.full(part.ray.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, part.ray, part.t0)
    return begin
