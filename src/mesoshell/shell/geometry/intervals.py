"""Intervals of rays, cut and put in order.

Notation
t0, t1      where an interval begins and ends along its ray                           world
visit       the intervals of one walk of a ray through the shell: they follow each other
run         rows in order of one visit: a visit is one run, or a few
"""

import numpy as np
from jaxtyping import Float, Int

from mesoshell.shell.geometry.batched_walk import Intervals, no_intervals


def cut(i: Intervals, begin: Float[np.ndarray, "I"], end: Float[np.ndarray, "I"] | float = np.inf) -> Intervals:
    """The parts of intervals between `begin` and `end`, λ and h interpolated there; empty ones are dropped."""
    t0, t1 = np.maximum(i.t0, begin), np.minimum(i.t1, end)
    kept = t1 > t0
    if not kept.all():
        i, t0, t1 = take(i, np.flatnonzero(kept)), t0[kept], t1[kept]
    moved = np.flatnonzero((t0 != i.t0) | (t1 != i.t1))
    if not len(moved):
        return i
    whole, ends = take(i, moved), []
    for t in (t0[moved], t1[moved]):
        share = ((t - whole.t0) / (whole.t1 - whole.t0)).astype(i.h0.dtype)
        bary = (1 - share)[:, None] * whole.bary0 + share[:, None] * whole.bary1
        ends.append((bary, (1 - share) * whole.h0 + share * whole.h1))
    i = i._replace(t0=t0, t1=t1, bary0=i.bary0.copy(), bary1=i.bary1.copy(), h0=i.h0.copy(), h1=i.h1.copy())
    (i.bary0[moved], i.h0[moved]), (i.bary1[moved], i.h1[moved]) = ends
    return i


def take(i: Intervals, rows: Int[np.ndarray, "I"]) -> Intervals:
    """Some of the intervals."""
    return Intervals(*(np.take(x, rows, axis=0) for x in i))


def without_overlap(parts: list[Intervals]) -> Intervals:
    """Sorted by ray and visit, each cut to begin no earlier than all before it on the same ray have ended. In a part each ray
    has one visit at most, whose runs grow along the ray."""
    if not parts:
        return no_intervals()
    i = Intervals(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    if not len(i.ray):
        return i
    i = take(i, _in_order(i, np.repeat(np.arange(len(parts)), [len(part.ray) for part in parts])))
    span = 2 * np.abs(i.t1).max()
    reached = np.maximum.accumulate(i.t1 + span * i.ray) - span * i.ray
    before = np.concatenate([[-np.inf], reached[:-1]])
    before[np.concatenate([[True], i.ray[1:] != i.ray[:-1]])] = -np.inf
    overlaps = before > i.t0 + 1e-9 * span
    return cut(i, np.where(overlaps, before, i.t0))


def _in_order(i: Intervals, part: Int[np.ndarray, "I"]) -> Int[np.ndarray, "I"]:
    """Rows by ray, then by where their visit begins, then along the ray: runs are sorted, not rows."""
    first = np.flatnonzero(np.concatenate([[True], (i.ray[1:] != i.ray[:-1]) | (part[1:] != part[:-1])]))
    length = np.diff(np.append(first, len(i.ray)))
    visits, visit = np.unique(part[first] * (i.ray.max() + 1) + i.ray[first], return_inverse=True)
    begin = np.full(len(visits), np.inf)
    np.minimum.at(begin, visit, i.t0[first])
    order = np.lexsort((i.t0[first], visit, begin[visit], i.ray[first]))
    first, length = first[order], length[order]
    return np.repeat(first - (np.cumsum(length) - length), length) + np.arange(len(i.ray))
