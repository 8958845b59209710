"""Samples on a ray's way through the box, against the box's own geometry and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.field import DENSITY, FieldConfig, init_field
from mesoshell.neutex.march import CELLS, at, dilate, march, places, span

FULL = jnp.ones((CELLS,) * 3, bool)
MIDDLE = jnp.full(48, 0.5)
SMALL = FieldConfig((8,), (8,), (8,), (8,), 8, "hash", hash=HashConfig(2, 2, 6, 4, 8), octaves=(2, 2, 1))
NUMBER = st.floats(-3, 3, width=32)


def unit(d) -> jnp.ndarray:
    d = np.asarray(d, np.float64)
    return jnp.asarray(d / np.linalg.norm(d), jnp.float32)


def test_a_diagonal_ray_sees_the_far_corner() -> None:
    """A fixed length of 2 would end before it."""
    t0, t1 = span(jnp.full(3, -2.0), unit([1, 1, 1]))
    np.testing.assert_allclose([t0, t1], [3**0.5, 3 * 3**0.5], rtol=1e-6)
    t, step = places(jnp.full(3, -2.0), unit([1, 1, 1]), FULL, MIDDLE)
    np.testing.assert_allclose(step * 48, 2 * 3**0.5, rtol=1e-5)
    assert float(t[-1]) > 3 * 3**0.5 - float(step)


@given(st.tuples(NUMBER, NUMBER, NUMBER), st.tuples(NUMBER, NUMBER, NUMBER).filter(lambda d: np.linalg.norm(d) > 0.1))
def test_the_span_is_what_fine_steps_find(o, d) -> None:
    o, d = np.array(o, np.float32), np.asarray(unit(d))
    t = np.linspace(0, 12, 24001)
    inside = (np.abs(o + t[:, None] * d) <= 1).all(axis=1)
    t0, t1 = (float(x) for x in span(jnp.asarray(o), jnp.asarray(d)))
    assert abs((t1 - t0) - inside.sum() * 12 / 24000) < 3e-3
    if inside.any():
        assert abs(t0 - t[inside][0]) < 2e-3


@pytest.mark.parametrize("d", [[0, 0, 0], [0, 0, 1], [1e-30, -1e-30, 1.0]])
def test_directions_with_zeros_are_finite(d) -> None:
    t, step = places(jnp.array([0.1, 0.2, -3.0]), jnp.array(d, jnp.float32), FULL, MIDDLE)
    assert bool(jnp.isfinite(t).all() & jnp.isfinite(step))


def test_samples_lie_in_occupied_cells_alone_and_share_their_length() -> None:
    occupied = FULL.at[:, :, 10:].set(False).at[:, :, 24:28].set(True)
    t, step = places(jnp.array([0.03, 0.01, -4.0]), jnp.array([0.0, 0.0, 1.0]), occupied, MIDDLE)
    z = -4 + np.asarray(t)
    cell = np.floor((z + 1) * CELLS / 2)
    # a probe's stretch is occupied if its middle is
    assert ((cell < 11) | ((cell > 22) & (cell < 29))).all()
    np.testing.assert_allclose(step * 48, 14 * 2 / CELLS, rtol=0.08)
    assert (np.diff(t) > 0).all()


def test_no_cell_no_sample() -> None:
    t, step = places(jnp.array([0.0, 0.0, -4.0]), jnp.array([0.0, 0.0, 1.0]), ~FULL, MIDDLE)
    assert float(step) == 0 and bool(jnp.isfinite(t).all())


def test_a_widened_cell_is_met_by_every_ray_through_it() -> None:
    """What a ray passes of an occupied cell itself lies in stretches that are sampled."""
    held = jnp.zeros((CELLS,) * 3, bool).at[5, 20, 13].set(True)
    wide = dilate(held)
    assert int(wide.sum()) == 27
    inside_of = jax.jit(lambda cells, o, d, t: at(cells, o[None] + jnp.outer(t, d)))
    span_of = jax.jit(span)
    random = np.random.default_rng(3)
    for _ in range(50):
        inside = (np.array([5, 20, 13]) + random.random(3)) * 2 / CELLS - 1
        d = random.normal(size=3)
        d /= np.linalg.norm(d)
        o, d = (jnp.asarray(x, jnp.float32) for x in (inside - 4 * d, d))
        t0, t1 = (float(x) for x in span_of(o, d))
        edges = np.linspace(t0, t1, 65)
        fine = np.linspace(t0, t1, 3000)
        mine = np.asarray(inside_of(held, o, d, jnp.asarray(fine, jnp.float32)))
        stretch = np.clip(np.searchsorted(edges, fine) - 1, 0, 63)
        middle = (edges[1:] + edges[:-1])[stretch] / 2
        assert np.asarray(inside_of(wide, o, d, jnp.asarray(middle, jnp.float32)))[mine].all()


def test_an_even_fog_has_the_closed_forms_transmittance() -> None:
    """All weights 0 but the bias: σ is DENSITY · log 2, wherever the samples lie."""
    field = jax.tree.map(jnp.zeros_like, init_field(SMALL, jax.random.key(0)))
    xi = jax.random.uniform(jax.random.key(1), (64,))
    o, d = jnp.array([0.2, -0.1, -3.0]), unit([0.05, 0.02, 1.0])
    t0, t1 = span(o, d)
    found = march(SMALL, field, o, d, FULL, xi)
    np.testing.assert_allclose(found.passed, np.exp(-DENSITY * np.log(2) * float(t1 - t0)), rtol=1e-3)
    np.testing.assert_allclose(float(found.w.sum() + found.passed), 1, rtol=1e-5)
    np.testing.assert_allclose(found.colour, np.log(2) * float(found.w.sum()), rtol=1e-5)


def test_gradients_are_finite_for_rays_that_miss_and_hit() -> None:
    field = init_field(SMALL, jax.random.key(0))
    along_z = jnp.array([0.0, 0.0, 1.0])
    slope = jax.jit(jax.grad(lambda f, o: march(SMALL, f, o, along_z, FULL, MIDDLE).colour.sum()))
    for o in ([0.0, 0.0, -3.0], [5.0, 5.0, 5.0], [0.0, 0.0, 0.0], [1.0, 1.0, -3.0]):
        g = slope(field, jnp.array(o))
        assert all(bool(jnp.isfinite(x).all()) for x in jax.tree.leaves(g))
