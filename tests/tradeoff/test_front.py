"""The front holds what nothing beats, and a gain is the area that an entry adds."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.tradeoff.front import GAIN, Entry, entries, front, gain
from mesoshell.tradeoff.points import Point

NUMBERS = st.floats(0.01, 100.0)
MANY = st.lists(st.tuples(NUMBERS, st.floats(0.001, 1.0)), min_size=1, max_size=12)


def point(seconds: float, flip: tuple[float, ...] = (0.1,)) -> Point:
    counts = tuple(2**i for i in range(len(flip)))
    zeros = (0.0,) * len(flip)
    return Point(
        {"samples": 48}, (seconds, seconds, seconds), 0.0, 10 * seconds, counts, flip, zeros, zeros, 0.0, 0.1, 0.0, 0.0
    )


def entry(seconds: float, flip: float) -> Entry:
    return Entry(point(seconds), 1, seconds, 10 * seconds, flip)


@given(MANY)
def test_nothing_beats_the_front(pairs) -> None:
    among = [entry(*pair) for pair in pairs]
    kept = front(among)
    assert all(not (e.seconds <= k.seconds and e.flip < GAIN * k.flip) for k in kept for e in among)
    assert all(any(k.seconds <= e.seconds and k.flip <= e.flip / GAIN for k in kept) for e in among)
    assert [k.seconds for k in kept] == sorted(k.seconds for k in kept)
    assert all(b.flip < GAIN * a.flip for a, b in pairwise(kept))
    assert front(kept) == kept


@given(MANY, NUMBERS, st.floats(0.001, 1.0))
def test_a_gain_is_the_area_that_is_added(pairs, seconds: float, flip: float) -> None:
    """Against the area of the union of rectangles, cell by cell."""
    kept = front(entry(*pair) for pair in pairs)
    x, y = (
        np.log([[getattr(e, name) for e in kept] + [new]]).ravel()
        for name, new in (("seconds", seconds), ("flip", flip))
    )
    corner = x.max() + 0.1, y.max() + 0.1
    edges = np.unique(np.append(x, corner[0])), np.unique(np.append(y, corner[1]))

    def area(count: int) -> float:
        covered = sum(
            dx * dy
            for a, dx in zip(edges[0][:-1], np.diff(edges[0]), strict=True)
            for b, dy in zip(edges[1][:-1], np.diff(edges[1]), strict=True)
            if ((x[:count] <= a) & (y[:count] <= b)).any()
        )
        return float(covered)

    np.testing.assert_allclose(gain(seconds, flip, kept), area(len(x)) - area(len(x) - 1), atol=1e-9)


def test_every_number_of_samples_is_an_entry() -> None:
    found = entries([point(0.5, (0.2, 0.1, 0.05))])
    assert [(e.samples, e.seconds, e.evaluations, e.flip) for e in found] == [
        (1, 0.5, 5.0, 0.2),
        (2, 1.0, 10.0, 0.1),
        (4, 2.0, 20.0, 0.05),
    ]
    assert [e.samples for e in front(found, lambda e: e.evaluations)] == [1, 2, 4]
