"""Samples: exact coordinates against Newton's method in float64; how a budget is spread, as laws over any intervals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mesoshell.geometry.mesh import check_mesh
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.extrude import Shell, extrude
from mesoshell.shell.geometry.sampling import Chart, Piece, frame, inverse_jacobian, place_exact, spread
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers import wearing

COUNT = 400


def twisted() -> Shell:
    """A sheet whose posts lean every way, so that the map of every prism is far from linear."""
    x, y = np.meshgrid(np.linspace(-1, 1, 6), np.linspace(-1, 1, 6), indexing="ij")
    points = np.stack([x, y, 0.3 * np.sin(4 * x) * np.cos(3 * y)], axis=-1).reshape(-1, 3)
    i = np.arange(36).reshape(6, 6)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return extrude(check_mesh(points, faces, points[faces][..., :2], "twisted"), 0.2, 1.0)


SHELL = twisted()
CHART = Chart(Boundary(SHELL, SHELL.faces).prisms.corners, jnp.asarray(SHELL.uv.reshape(-1, 6)))


def at(prism: np.ndarray, bary: np.ndarray, h: np.ndarray) -> np.ndarray:
    """P(λ, h) in float64."""
    b, o = (x[SHELL.faces[prism]].astype(np.float64) for x in (SHELL.base, SHELL.offset))
    weights = np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
    return np.einsum("ik,ikj->ij", weights, b + h[:, None, None] * o)


def newton(prism: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """λ and h of x, with a Jacobian by differences: slow, and independent of the formula under test."""
    place = np.tile([1 / 3, 1 / 3, 0.5], (len(x), 1))
    for _ in range(30):
        steps = place[:, None] + np.array([1, -1])[:, None, None, None] * 1e-6 * np.eye(3)
        high, low = (np.stack([at(prism, s[:, k, :2], s[:, k, 2]) for k in range(3)], axis=-1) for s in steps)
        off = x - at(prism, place[:, :2], place[:, 2])
        place += np.linalg.solve((high - low) / 2e-6, off[..., None])[..., 0]
    assert np.abs(x - at(prism, place[:, :2], place[:, 2])).max() < 1e-12
    return place[:, :2], place[:, 2]


def pieces() -> tuple[Piece, np.ndarray, np.ndarray]:
    """Segments between two random points of a prism; the true (u, v, h) at random positions f, and those."""
    rng = np.random.default_rng(1)
    prism = rng.integers(0, len(SHELL.faces), COUNT)
    bary, h = rng.dirichlet((1, 1, 1), (2, COUNT))[..., :2], rng.uniform(size=(2, COUNT))
    x = [at(prism, bary[k], h[k]) for k in (0, 1)]
    length = np.linalg.norm(x[1] - x[0], axis=1)
    f = rng.uniform(size=COUNT)
    where, height = newton(prism, x[0] + f[:, None] * (x[1] - x[0]))
    uv = SHELL.uv[prism].astype(np.float64)
    weights = np.concatenate([where, 1 - where.sum(axis=1, keepdims=True)], axis=1)
    xi = np.concatenate([np.einsum("ik,ikj->ij", weights, uv), height[:, None]], axis=1)
    t = np.stack([np.zeros(COUNT), length], axis=1)
    direction = (x[1] - x[0]) / length[:, None]
    start = x[0] - SHELL.base[SHELL.faces[prism, 2]]
    arrays = (t, bary.transpose(1, 0, 2), h.T, start, direction)
    return Piece(jnp.asarray(prism, jnp.int32), *(jnp.asarray(v, jnp.float32) for v in arrays)), f, xi


def test_exact_coordinates_are_exact_and_interpolated_ones_are_close():
    piece, f, xi = pieces()
    frames = jax.vmap(frame, in_axes=(None, 0))(CHART, piece)
    exact = jax.vmap(place_exact, in_axes=(None, 0, 0))(CHART, piece, jnp.asarray(f, jnp.float32))
    assert np.abs(np.asarray(exact) - xi).max() < 2e-5
    straight = np.asarray(frames.xi0) + f[:, None] * np.asarray(frames.xi1 - frames.xi0)
    off = np.abs(straight - xi).max(axis=1)
    assert 1e-3 < off.max() < 0.2


def test_exact_coordinates_far_from_the_origin():
    """Where floats are 1/16 apart: the prisms' corners lie there, and what is between them is as exact as here."""
    away = np.array([2.0**19, -(2.0**19), 2.0**19])
    rng = np.random.default_rng(3)
    mesh = check_mesh(np.round(48 * wearing.ball().vertices) / 16 + away, wearing.ball().faces, None, "ball")
    shell = extrude(mesh, 0.25, 1.0)
    prism, f = rng.integers(0, len(shell.faces), COUNT), rng.uniform(size=COUNT).astype(np.float32)
    bary, h = rng.dirichlet((1, 1, 1), (2, COUNT)), rng.uniform(size=(2, COUNT))
    base = shell.base.astype(np.float64)[shell.faces[prism]]
    corners = base + h[:, :, None, None] * shell.offset[shell.faces[prism]]
    x = np.einsum("kni,knij->knj", bary, corners)
    length = np.linalg.norm(x[1] - x[0], axis=1)
    rows = (
        np.stack([np.zeros(COUNT), length], axis=1),
        bary[..., :2].transpose(1, 0, 2),
        h.T,
        x[0] - base[:, 2],
        (x[1] - x[0]) / length[:, None],
    )
    piece = Piece(jnp.asarray(prism, jnp.int32), *(jnp.asarray(row, jnp.float32) for row in rows))
    chart = Chart(Boundary(shell, shell.faces).prisms.corners, jnp.asarray(shell.uv.reshape(-1, 6)))
    xi = np.asarray(jax.vmap(place_exact, in_axes=(None, 0, 0))(chart, piece, jnp.asarray(f)), np.float64)
    uv = shell.uv[prism].astype(np.float64)
    e = np.stack([uv[:, 0] - uv[:, 2], uv[:, 1] - uv[:, 2]], axis=-1)
    lam = np.linalg.solve(e, (xi[:, :2] - uv[:, 2])[..., None])[..., 0]
    lam = np.concatenate([lam, 1 - lam.sum(axis=1, keepdims=True)], axis=1)
    found = np.einsum("ni,nij->nj", lam, base + xi[:, 2, None, None] * shell.offset[shell.faces[prism]])
    off = np.linalg.norm(found - (x[0] + f[:, None] * (x[1] - x[0])), axis=1)
    assert off.max() < 1e-3 * 0.25


def test_inverse_jacobian_by_differences():
    piece, _, _ = pieces()
    prism, bary, h = np.asarray(piece.prism), np.asarray(piece.bary[:, 0], np.float64), np.asarray(piece.h[:, 0])
    inverse = np.asarray(
        jax.vmap(inverse_jacobian, in_axes=(None, 0, 0, 0))(CHART, piece.prism, piece.bary[:, 0], piece.h[:, 0]),
        np.float64,
    )
    uv, step, h = SHELL.uv[prism].astype(np.float64), 1e-6, h.astype(np.float64)
    e = np.stack([uv[:, 0] - uv[:, 2], uv[:, 1] - uv[:, 2]], axis=-1)
    moved = [(bary + step * v, h) for v in np.eye(2)] + [(bary, h + step)]
    world = np.stack([(at(prism, *m) - at(prism, bary, h)) / step for m in moved], axis=-1)
    chart = np.zeros((COUNT, 3, 3))
    chart[:, :2, :2], chart[:, 2, 2] = e, 1
    np.testing.assert_allclose(inverse @ world, chart, atol=2e-4)


@st.composite
def intervals(draw: st.DrawFn) -> tuple[Intervals, np.ndarray]:
    """Intervals of some rays, sorted, and their canonical lengths from nothing to much."""
    counts = draw(st.lists(st.integers(1, 9), min_size=0, max_size=6))
    ray = np.repeat(np.arange(len(counts)) * 3, counts)
    lengths = st.one_of(st.just(0.0), st.floats(2.0**-20, 2.0**10, width=32))
    length = np.array(draw(st.lists(lengths, min_size=len(ray), max_size=len(ray))), np.float32)
    none, pair = np.zeros(len(ray), np.float32), np.zeros((len(ray), 2), np.float32)
    return Intervals(ray, np.zeros(len(ray), np.int32), none, none, pair, pair, none, none), length


@given(intervals(), st.integers(1, 64), st.sampled_from([0.125, 0.5, 0.96875]))
@settings(max_examples=200, deadline=None)
def test_samples_by_length_add_up_to_the_budget(case: tuple[Intervals, np.ndarray], samples: int, shift: float):
    i, length = case
    plan = spread(i, length, samples, "length", shift)
    within = np.concatenate([np.arange(n) for n in plan.count]) if len(i.ray) else np.zeros(0)
    row = np.repeat(np.arange(len(i.ray)), plan.count)
    position = (plan.first[row] + within + shift) * plan.step[row] - plan.begin[row]
    slack = 1e-5 * (plan.begin + length)[row] + 1e-30
    assert (position >= -slack).all() and (position <= length[row] + slack).all()
    assert (plan.count >= 0).all()
    for r in np.unique(i.ray):
        at_ray = i.ray == r
        assert plan.count[at_ray].sum() == samples
        np.testing.assert_array_equal(plan.first[at_ray], np.cumsum(plan.count[at_ray]) - plan.count[at_ray])
        total = length[at_ray].sum(dtype=np.float64)
        np.testing.assert_allclose((plan.count * plan.step)[at_ray].sum(), total, rtol=1e-5, atol=1e-30)
        share = plan.count[at_ray] - length[at_ray] / max(total, 1e-30) * samples
        assert np.abs(share).max() <= 1.01 or total == 0


@given(intervals(), st.integers(1, 64))
@settings(max_examples=200, deadline=None)
def test_samples_by_interval_leave_none_out(case: tuple[Intervals, np.ndarray], samples: int):
    i, length = case
    plan = spread(i, length, samples, "interval")
    assert (plan.count >= 1).all() and (plan.first == 0).all()
    np.testing.assert_allclose(plan.count * plan.step, length, rtol=1e-6)
    for r in np.unique(i.ray):
        count = plan.count[i.ray == r]
        assert count.sum() == max(samples, len(count))
        assert count.max() - count.min() <= 1


@pytest.mark.parametrize("spacing", ["length", "interval"])
def test_no_intervals(spacing: str):
    none, pair, index = np.zeros(0, np.float32), np.zeros((0, 2), np.float32), np.zeros(0, np.int32)
    plan = spread(Intervals(index, index, none, none, pair, pair, none, none), none, 8, spacing)
    assert not len(plan.count)
