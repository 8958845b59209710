"""The Pareto front: what no other settings beat in both time and error.

Notation
entry       a point and a number of samples a pixel n; it takes n times the median of a pass, and has the error e(n)
area        between the front and a corner, in logarithms of cost and error: what a further entry adds is its worth
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from mesoshell.tradeoff.knobs import describe_changes
from mesoshell.tradeoff.points import Point

#: Error of an entry of the front at most, of that before it.
GAIN = 0.98


class Entry(NamedTuple):
    """seconds: of all passes; evaluations: network queries a pixel; flip: e(n)."""

    point: Point
    samples: int
    seconds: float
    evaluations: float
    flip: float

    @property
    def described(self) -> str:
        return f"{self.samples} samples a pixel, {describe_changes(self.point.settings)}"


def entries(points: Iterable[Point]) -> list[Entry]:
    """Every measured number of samples of every point."""
    return [
        Entry(p, n, n * p.seconds[1], n * p.evaluations, e)
        for p in points
        for n, e in zip(p.samples, p.flip, strict=True)
    ]


def front(among: Iterable[Entry], cost: Callable[[Entry], float] = lambda e: e.seconds) -> list[Entry]:
    """Those that none beats, by growing cost, without those that gain next to nothing on the one before."""
    best, chosen = np.inf, []
    for entry in sorted(among, key=lambda e: (cost(e), e.flip)):
        if entry.flip < GAIN * best:
            best = entry.flip
            chosen.append(entry)
    return chosen


def gain(cost: float, error: float, kept: Sequence[Entry]) -> float:
    """Area that an entry of this cost in seconds and error adds to a front. The corner is the front's dearest and worst; what
    lies beyond it counts as lying at it."""
    x = np.log([e.seconds for e in kept] + [cost])
    y = np.log(np.maximum([e.flip for e in kept] + [error], 1e-6))
    corner = max(x) + 0.1, max(y) + 0.1
    order = np.argsort(x[:-1])
    right, level = np.append(x[:-1][order], corner[0]), np.append(corner[1], y[:-1][order])
    at, new = x[-1], y[-1]
    total, left = 0.0, -np.inf
    for k in range(len(right)):  # the front is at `level[k]` from `left` to `right[k]`
        if right[k] > at:
            total += max(0.0, level[k] - new) * (right[k] - max(at, left))
        left = right[k]
    return total
