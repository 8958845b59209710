"""Hard case 2: rays at 1e-3 and 1e-5 to a side or a cap; the oracle is mpmath on the same float32 numbers.

Whatever float32 gets wrong (hit or miss, or the place by more than 1e-3 of the face) must carry `doubt`. Where a ray
meets the shell is up to Embree, in float32: a chord must be that of a ray at most SHIFT of the scene away. All this holds with
operands of matrix products as a GPU or a TPU would have them, too (benchmarks/products).
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.products import BITS, rounded
from mesoshell.geometry import patch
from mesoshell.shell.geometry import batched_walk
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers.stability.hard_rays import COUNT, SHIFT, grazed_sides, grazing
from tests.helpers.stability.oracles import mp_leave_cap, mp_leave_side, span_of_convex
from tests.helpers.stability.sides import OPERANDS, leave_sides, on
from tests.helpers.stability.surfaces import ball, unit

OFF = 1e-3


@lru_cache
def sides(angle: float, twist: float) -> tuple[tuple, tuple]:
    """Rays and sides, and what mpmath says of them: hit, u, h."""
    given = grazed_sides(angle, twist, np.random.default_rng(2))
    hit, _, u, h = (np.array(x) for x in zip(*map(mp_leave_side, *given), strict=True))
    return given, (hit, u, h)


def wrong_and_unflagged(operands: str, angle: float, twist: float) -> int:
    (d, p, n), (hit, u, h) = sides(angle, twist)
    assert hit.sum() > COUNT / 4
    found = leave_sides(d, p, n, operands)
    off = np.maximum(np.abs(found.u - u), np.abs(found.h - h))
    wrong = ((found.inside >= 0) != hit) | (hit & (off > OFF))
    return int((wrong & ~found.doubt).sum())


@pytest.mark.parametrize("operands", OPERANDS)
@pytest.mark.parametrize("twist", [0.0, 1e-4, 0.5])
@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_no_side_is_wrong_and_unflagged(angle: float, twist: float, operands: str):
    assert wrong_and_unflagged(operands, angle, twist) == 0


@pytest.mark.parametrize("operands", BITS)
def test_products_that_an_accelerator_rounds_would_be_wrong(operands: str, monkeypatch):
    """The same sides by `jnp.dot`: so the test above can fail."""
    monkeypatch.setattr(patch, "product", jnp.dot)
    jax.clear_caches()
    assert wrong_and_unflagged(operands, 1e-3, 0.5) > COUNT / 4
    jax.clear_caches()


@lru_cache
def caps(angle: float) -> tuple[tuple, tuple]:
    """Rays and caps, and what mpmath says of them: hit, barycentric coordinates."""
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(COUNT, 3, 3))
    weights = rng.dirichlet((1, 1, 1), COUNT) * 1.3 - 0.1
    d = grazing(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), angle, rng)
    at = np.einsum("rk,rki->ri", weights, corners) - rng.uniform(0.1, 4, (COUNT, 1)) * d
    d, corners = d.astype(np.float32), (corners - at[:, None]).astype(np.float32)
    hit, exact = (np.array(x) for x in zip(*map(mp_leave_cap, d, corners), strict=True))
    return (d, corners), (hit, exact)


@pytest.mark.parametrize("operands", OPERANDS)
@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_no_cap_is_wrong_and_unflagged(angle: float, operands: str):
    given, (hit, exact) = caps(angle)
    found, where = on(operands, jax.vmap(lambda d, c: patch.leave_cap(d, c, 1)))(*given)
    wrong = ((found.inside >= 0) != hit) | (hit & (np.abs(where - exact).max(axis=1) > OFF))
    assert hit.sum() > COUNT / 4
    assert not (wrong & ~found.doubt).any()


@pytest.fixture(params=OPERANDS)
def _walking(request, monkeypatch):
    """The walk's programs with such operands."""
    if request.param in BITS:
        monkeypatch.setattr(batched_walk, "_advance", jax.jit(rounded(batched_walk._advance, BITS[request.param])))


@pytest.mark.usefixtures("_walking")
@pytest.mark.parametrize("angle", [1e-3, 1e-5])
def test_chords_of_rays_that_graze_a_shell(angle: float):
    mesh = ball()
    shell = extrude(mesh, 0.2, 1.0)
    rng = np.random.default_rng(4)
    faces = rng.integers(0, len(shell.faces), 1000)
    top = (shell.base.astype(np.float64) + shell.offset)[shell.faces]
    normal = np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])[faces]
    d = grazing(-normal, angle, rng)
    o = np.einsum("rk,rki->ri", rng.dirichlet((1, 1, 1), 1000), top[faces]) - 2 * d
    trace = Boundary(shell, mesh.faces).trace(o, d)
    base = span_of_convex(shell.base[shell.faces].astype(np.float64), o, d)
    assert (base[0] > base[1]).all()
    shifts = [span_of_convex(top, o + s * unit(normal), d) for s in (-SHIFT, SHIFT)]
    longest, shortest = (np.maximum(leaves - enters, 0) for enters, leaves in shifts)
    length = np.bincount(trace.intervals.ray, trace.intervals.t1 - trace.intervals.t0, minlength=1000)
    assert (length > 0).mean() > 0.95
    assert (length >= shortest - 1e-6).all() and (length <= longest + 1e-6).all()
