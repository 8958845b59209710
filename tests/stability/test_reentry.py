"""Hard case 7: two hits on one side, several visits, re-entry, a camera inside the shell.

The oracle cuts every ray into 4000 points and inverts the prisms' maps in float64: a point is inside just where some
interval covers it, up to one step at the intervals' ends.
"""

import numpy as np
import pytest

from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.stability.prisms import prism_point
from tests.helpers.stability.hard_rays import OVERLAPPING, SCENES, assert_as_sampled, rays_through
from tests.helpers.stability.oracles import (
    assert_ends_on_ray,
    assert_sorted_apart,
    mp_leave_side,
    total_length,
)
from tests.helpers.stability.sides import leave_sides
from tests.helpers.stability.surfaces import sheet, together, unit


@pytest.mark.parametrize("opaque", [True, False])
@pytest.mark.parametrize("scene", SCENES)
def test_intervals_are_where_the_shell_is(scene: str, opaque: bool):
    mesh, thickness = SCENES[scene]
    shell = extrude(mesh, thickness, 1.0)
    o, d = rays_through(mesh, 12, 8)
    trace = Boundary(shell, mesh.faces, opaque=opaque).trace(o, d)
    visits = assert_as_sampled(trace, shell, o, d, 6.0)
    if scene != OVERLAPPING:
        assert_ends_on_ray(trace, shell, o, d, 1e-5)
    if not opaque:
        assert visits.max() >= 2


@pytest.mark.parametrize("scene", SCENES)
def test_a_camera_inside_the_shell(scene: str):
    mesh, thickness = SCENES[scene]
    shell = extrude(mesh, thickness, 1.0)
    rng = np.random.default_rng(9)
    prism = rng.integers(0, len(shell.faces), 12)
    o = prism_point(shell, prism, rng.dirichlet((2, 2, 2), 12)[:, :2], rng.uniform(0.1, 0.9, 12))
    d = unit(rng.normal(size=(12, 3)))
    trace = Boundary(shell, mesh.faces).trace(o, d)
    assert_as_sampled(trace, shell, o, d, 5.0)
    assert (np.isin(np.arange(12), trace.intervals.ray[trace.intervals.t0 == 0])).all()


def test_both_hits_on_one_side():
    """A line meets a saddle-shaped side twice: seen from either of its two faces, the ray leaves through it once."""
    count = 500
    rng = np.random.default_rng(10)
    p = np.array([[-1, -0.4, -0.5], [1, 0.4, -0.5]]) + rng.uniform(-0.1, 0.1, (count, 2, 3))
    n = np.array([[0, 0.8, 1], [0, -0.8, 1]]) + rng.uniform(-0.1, 0.1, (count, 2, 3))
    d = unit(np.array([0.75, 0, 0.66]) + rng.uniform(-0.1, 0.1, (count, 3))).astype(np.float32)
    p, n = (p + np.array([0.4, 0.1, 0.3])).astype(np.float32), n.astype(np.float32)
    sides = [(p, n), (p[:, ::-1], n[:, ::-1])]
    exact = [[mp_leave_side(*row) for row in zip(d, *side, strict=True)] for side in sides]
    for (p, n), rows in zip(sides, exact, strict=True):
        found = leave_sides(d, p, n)
        hit, t, u, h = (np.array(x) for x in zip(*rows, strict=True))
        sure = ~found.doubt
        np.testing.assert_array_equal((found.inside >= 0)[sure], hit[sure])
        for a, b in ((found.t, t), (found.u, u), (found.h, h)):
            np.testing.assert_allclose(a[sure & hit], b[sure & hit], atol=1e-3)
    assert sum(first[0] and second[0] for first, second in zip(*exact, strict=True)) >= 10


def test_an_object_in_the_shell_stops_the_ray():
    """An object in the shell: a plate at a third of the height of a flat carpet."""
    mesh = sheet(lambda x, y: 0 * x)
    plate = np.array([[[-2, -2, 0.1], [2, -2, 0.1], [0, 3, 0.1]]])
    shell = extrude(mesh, 0.3, 1.0)
    boundary = Boundary(shell, mesh.faces, others=plate)
    slanted = unit(np.array([0.6, 0.2, -1.0]))
    o, d = np.array([[0.1, 0.05, 2.0], [-0.9, 0.05, 2.0]]), np.array([[0, 0, -1.0], slanted])
    trace = boundary.trace(o, d)
    assert trace.face.tolist() == [len(mesh.faces)] * 2
    np.testing.assert_allclose(trace.end, 1.9 / -d[:, 2], rtol=1e-6)
    np.testing.assert_allclose(total_length(trace, 2), 0.2 / -d[:, 2], rtol=1e-5)
    assert_ends_on_ray(trace, shell, o, d, 1e-5)


@pytest.mark.parametrize("down", [1.0, -1.0])
def test_any_number_of_shells_is_passed(down: float):
    """Forty sheets, one behind the other, whose bases let rays pass."""
    count, thickness = 40, 0.02
    sheets = together(*(sheet(lambda x, y, k=k: 0.05 * k + 0 * x, 3) for k in range(count)))
    shell = extrude(sheets, thickness, 1.0)
    rng = np.random.default_rng(8)
    d = unit(np.concatenate([0.05 * rng.normal(size=(64, 2)), np.full((64, 1), -down)], axis=1))
    o = np.concatenate([rng.uniform(-0.3, 0.3, (64, 2)), np.full((64, 1), 1 + 2 * down)], axis=1)
    trace = Boundary(shell, sheets.faces, opaque=False).trace(o, d)
    assert_sorted_apart(trace)
    np.testing.assert_allclose(total_length(trace, 64), count * thickness / np.abs(d[:, 2]), rtol=1e-5)
