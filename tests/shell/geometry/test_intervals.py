"""Intervals are cut and put in order: laws over random visits, against the length of unions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.intervals import cut, take, without_overlap

SEEDS = st.integers(0, 2**32 - 1)


def visits(rng: np.random.Generator, rays: int, most: int) -> Intervals:
    """One visit of some rays in order of rays, each of up to so many intervals, of which some are kept; λ₀ and h are t/10."""
    chosen = np.flatnonzero(rng.random(rays) < 0.7)
    lengths = rng.integers(1, most + 1, len(chosen))
    ray = np.repeat(chosen, lengths)
    begin, step = rng.uniform(0, 5, rays), rng.uniform(0.01, 1, len(ray))
    total = np.cumsum(step)
    first = np.searchsorted(ray, ray)
    t1 = begin[ray] + total - total[first] + step[first]
    t0 = t1 - step
    kept = rng.random(len(ray)) < 0.9
    h0, h1 = ((t / 10).astype(np.float32) for t in (t0, t1))
    bary0, bary1 = (np.stack([h, np.zeros_like(h)], axis=1) for h in (h0, h1))
    whole = Intervals(ray, np.arange(len(ray), dtype=np.int32), t0, t1, bary0, bary1, h0, h1)
    return take(whole, np.flatnonzero(kept))


def in_two_runs(i: Intervals) -> Intervals:
    """The same visits, of which the first intervals come before all others, as a walk of many prisms gives them."""
    late = np.arange(len(i.ray)) - np.searchsorted(i.ray, i.ray) >= 2
    return take(i, np.argsort(late, kind="stable"))


def one_by_one(visits: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Length of a ray's visits by where they begin, each cut to begin no earlier than all before it have ended."""
    total, reached = 0.0, -np.inf
    for t0, t1 in sorted((v for v in visits if len(v[0])), key=lambda v: v[0].min()):
        for a, b in zip(t0, t1, strict=True):
            total += max(0.0, b - max(a, reached))
            reached = max(reached, b)
    return total


def test_visits_that_begin_at_one_place_are_not_mixed():
    """As of a camera in two shells: the first of them wins, and is whole."""
    t = np.arange(6.0)
    none = np.zeros((6, 2), np.float32)
    first = Intervals(np.zeros(6, int), np.arange(6), t, t + 1, none, none, none[:, 0], none[:, 0])
    second = first._replace(prism=np.arange(6) + 10, t0=1.5 * t, t1=1.5 * t + 1.5)
    i = without_overlap([in_two_runs(first), in_two_runs(second)])
    assert i.prism.tolist() == [0, 1, 2, 3, 4, 5, 14, 15]


@given(SEEDS, st.integers(1, 6), st.integers(1, 4))
def test_what_overlaps_is_counted_once(seed: int, rays: int, parts: int):
    rng = np.random.default_rng(seed)
    given_ = [visits(rng, rays, 5) for _ in range(parts)]
    i = without_overlap([in_two_runs(part) for part in given_])
    assert (np.diff(i.ray) >= 0).all()
    same = i.ray[1:] == i.ray[:-1]
    assert (i.t0[1:] >= i.t1[:-1] - 1e-7)[same].all()
    assert (i.t1 > i.t0).all()
    for ray in range(rays):
        kept = one_by_one([(part.t0[part.ray == ray], part.t1[part.ray == ray]) for part in given_])
        np.testing.assert_allclose((i.t1 - i.t0)[i.ray == ray].sum(), kept, atol=1e-6)
    np.testing.assert_allclose(i.h0, i.t0 / 10, atol=1e-6)
    np.testing.assert_allclose(i.bary1[:, 0], i.t1 / 10, atol=1e-6)


@given(SEEDS)
def test_the_order_does_not_depend_on_how_a_visit_comes(seed: int):
    rng = np.random.default_rng(seed)
    parts = [visits(rng, 4, 6) for _ in range(3)]
    for a, b in zip(without_overlap(parts), without_overlap([in_two_runs(part) for part in parts]), strict=True):
        np.testing.assert_array_equal(a, b)


@given(SEEDS)
def test_a_cut_keeps_what_lies_between(seed: int):
    rng = np.random.default_rng(seed)
    i = visits(rng, 4, 5)
    begin, end = rng.uniform(0, 6, len(i.ray)), rng.uniform(2, 8, len(i.ray))
    got = cut(i, begin, end)
    length = np.maximum(np.minimum(i.t1, end) - np.maximum(i.t0, begin), 0)
    np.testing.assert_allclose((got.t1 - got.t0).sum(), length.sum(), atol=1e-9)
    np.testing.assert_allclose(got.h0, got.t0 / 10, atol=1e-6)
    np.testing.assert_allclose(got.bary1[:, 0], got.t1 / 10, atol=1e-6)


def test_a_cut_that_moves_nothing_copies_nothing():
    i = visits(np.random.default_rng(0), 5, 4)
    assert cut(i, i.t0) is i


def test_no_intervals_stay_none():
    none = visits(np.random.default_rng(0), 0, 4)
    assert len(without_overlap([]).ray) == len(without_overlap([none]).ray) == len(cut(none, none.t0).ray) == 0
