"""Hard case 8: rays without length, direction or finite numbers miss, end, and leave their neighbours as they were.

The oracle is the same batch without them.
"""

import numpy as np
import pytest

from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers.stability.hard_rays import BAD
from tests.helpers.stability.surfaces import ball, rays_at

MESH = ball(1)
BOUNDARY = Boundary(extrude(MESH, 0.2, 1.0), MESH.faces)


@pytest.mark.parametrize("bad", BAD)
def test_it_misses_and_its_neighbours_do_not_notice(bad: str):
    rng = np.random.default_rng(11)
    o, d = rays_at(0.5 * rng.normal(size=(20, 3)), 3.0, rng)
    alone = BOUNDARY.trace(o, d)
    at = np.array([0, 7, 20])
    bad_o, bad_d = BAD[bad]
    mixed = BOUNDARY.trace(np.insert(o, at, bad_o, axis=0), np.insert(d, at, bad_d, axis=0))
    is_bad = ~np.isin(np.arange(23), np.delete(np.arange(23), at + np.arange(3)))
    assert np.isinf(mixed.end[is_bad]).all() and (mixed.face[is_bad] == -1).all()
    assert not is_bad[mixed.intervals.ray].any()
    np.testing.assert_array_equal(mixed.end[~is_bad], alone.end)
    renamed = np.flatnonzero(~is_bad)[alone.intervals.ray]
    for a, b in zip(mixed.intervals, alone.intervals._replace(ray=renamed), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_batch_of_nothing_else():
    trace = BOUNDARY.trace(np.array([o for o, _ in BAD.values()], float), np.array([d for _, d in BAD.values()], float))
    assert not len(trace.intervals.ray) and np.isinf(trace.end).all()


def test_no_rays_at_all():
    trace = BOUNDARY.trace(np.zeros((0, 3)), np.zeros((0, 3)))
    assert not len(trace.intervals.ray) and not len(trace.end)
