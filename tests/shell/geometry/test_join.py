"""Joined shells are what they were apart: rays meet each as they do alone."""

import numpy as np

from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.join import join_shells
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers import wearing


def test_rays_meet_each_as_alone():
    """A ball, a sheet with borders and a tube: intervals, ends and faces of a thousand rays, of one shell after another."""
    meshes = [
        wearing.ball(0.5, 12, 6),
        wearing.moved(wearing.tube(0.4, 0.8, 9, 3), 2, 0, 0),
        wearing.moved(wearing.lump(), 0, 3, 0),
    ]
    parts = [(mesh, extrude(mesh, 0.1, 0.3)) for mesh in meshes]
    mesh, shell = join_shells(tuple(parts))
    assert join_shells((parts[0],)) is parts[0]
    random = np.random.default_rng(0)
    d = wearing.directions(random, 1000)
    prisms, faces = np.cumsum([0, *(len(s.faces) for _, s in parts)]), np.cumsum([0, *(len(m.faces) for m in meshes)])
    together = Boundary(shell, mesh.faces)
    assert len(shell.faces) == prisms[-1] and len(mesh.faces) == faces[-1]
    for k, (own, alone) in enumerate(parts):
        middle = own.vertices.mean(axis=0, dtype=np.float64)
        o = middle - 1.2 * d + 0.3 * wearing.directions(random, 1000)
        wanted = Boundary(alone, own.faces).trace(o, d)
        found = together.trace(o, d)
        mine = (found.intervals.prism >= prisms[k]) & (found.intervals.prism < prisms[k + 1])
        first = found.intervals.ray[mine]
        missed = np.setdiff1d(np.unique(wanted.intervals.ray), np.unique(first))
        others = np.unique(found.intervals.ray[~mine])
        alike = np.isin(wanted.intervals.ray, np.union1d(missed, others), invert=True)
        same = np.isin(first, others, invert=True)
        assert same.sum() > 500 and len(missed) < 5
        np.testing.assert_array_equal(found.intervals.prism[mine][same] - prisms[k], wanted.intervals.prism[alike])
        np.testing.assert_allclose(found.intervals.t0[mine][same], wanted.intervals.t0[alike], atol=1e-5)
        np.testing.assert_allclose(found.intervals.t1[mine][same], wanted.intervals.t1[alike], atol=1e-5)
        ended = np.isfinite(wanted.end) & np.isclose(found.end, wanted.end, rtol=0, atol=1e-5)
        assert ended.sum() > 300
        np.testing.assert_array_equal(found.face[ended] - faces[k], wanted.face[ended])
