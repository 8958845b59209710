"""Samples by density on rays of paths: no bias whatever the σ grid holds, many where light is lost, and always an end.

Oracle: sums over the cells that a ray passes, in float64.
"""

import mesoshell.pathtracer  # noqa: F401  isort: skip  (it makes Mitsuba ready)

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.geometry.mesh import check_mesh
from mesoshell.pathtracer.free_flight import fly
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.samples import Ray
from mesoshell.pathtracer.shells import Shells
from mesoshell.render.effects import PATHS, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.render.quality import PRESETS, WIDEST
from mesoshell.shell.geometry.extrude import extrude

#: Patches along the square, and cells of the σ grid along a patch and along the height.
SIDE, CELLS = 4, 8
SHIFTS = 512


class Blocks:
    """A medium of one σ a cell, of SIDE · CELLS × SIDE · CELLS × CELLS (u, v, h) from `first` patches on; bound: what the grid
    says of each."""

    def __init__(self, sigma: np.ndarray, bound: np.ndarray, first: int = 0):
        self.tables, self.first = [mi.Float(x.astype(np.float32).ravel()) for x in (sigma, bound)], first

    def cells(self, sample, taps) -> mi.Vector3f:
        return mi.Vector3f(CELLS)

    def bound(self, sample, taps) -> mi.Float:
        return dr.gather(mi.Float, self.tables[1], self._index(sample.xi))

    def sigma(self, sample, taps, baked) -> mi.Float:
        return dr.gather(mi.Float, self.tables[0], self._index(sample.xi))

    def _index(self, xi) -> mi.UInt32:
        most = (SIDE * CELLS - 1, SIDE * CELLS - 1, CELLS - 1)
        place = [(xi.x - self.first) * CELLS, (xi.y - self.first) * CELLS, xi.z * CELLS]
        u, v, h = (mi.UInt32(dr.clip(x, 0, n)) for x, n in zip(place, most, strict=True))
        return (u * (SIDE * CELLS) + v) * CELLS + h


def context(medium: Blocks, **quality: object) -> RenderContext:
    """A flat shell of height 1 over a square of SIDE patches of 1."""
    corners = SIDE * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    shells = Shells([extrude(check_mesh(corners, faces, (corners[faces] + medium.first)[..., :2], "square"), 1.0, 1.0)])
    asked = PRESETS["normal"].with_changes(samples=20, anisotropy=1, early_stop=0.0, skip=0.0).with_changes(**quality)
    return RenderContext(
        shells, medium, None, asked, plan_effects(Facts(shells=1, distant=1, convex=True), asked, PATHS)
    )


def ray(o: np.ndarray, d: np.ndarray) -> Ray:
    n = len(o)
    zero, far, yes = dr.zeros(mi.Float64, n), dr.full(mi.Float64, 100.0, n), dr.full(mi.Bool, True, n)
    spread = dr.zeros(mi.Float, n)
    return Ray(mi.Vector3d(o.T.copy()), mi.Vector3d(d.T.copy()), zero, far, yes, spread, mi.Float(spread))


def rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """From above the square, down through it."""
    rng = np.random.default_rng(seed)
    foot = np.concatenate([rng.uniform(0.3, SIDE - 0.3, (count, 2)), np.zeros((count, 1))], axis=1)
    d = rng.normal(size=(count, 3)) * [1, 1, 0.5]
    d[:, 2] = -np.abs(d[:, 2]) - 0.05
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return foot - 50 * d, d


def true_depth(sigma: np.ndarray, o: np.ndarray, d: np.ndarray) -> float:
    """Σ σ · length over the cells that a ray passes."""
    t0, t1 = (1 - o[2]) / d[2], -o[2] / d[2]
    for k in (0, 1):
        sides = sorted([(0 - o[k]) / d[k], (SIDE - o[k]) / d[k]])
        t0, t1 = max(t0, sides[0]), min(t1, sides[1])
    cuts = [t0, t1]
    for k, n in enumerate((SIDE * CELLS, SIDE * CELLS, CELLS)):
        cuts.extend(((np.arange(n + 1) / CELLS) - o[k]) / d[k])
    t = np.unique(np.clip(cuts, t0, t1))
    x = o + 0.5 * (t[1:] + t[:-1])[:, None] * d
    u, v, h = (np.clip((x[:, k] * CELLS).astype(int), 0, n - 1) for k, n in enumerate(sigma.shape))
    return float(sigma[u, v, h] @ np.diff(t))


def blocks(seed: int) -> np.ndarray:
    """A third of the cells hold matter."""
    rng = np.random.default_rng(seed)
    some = rng.random((SIDE * CELLS, SIDE * CELLS, CELLS)) < 0.33
    return np.where(some, rng.uniform(0, 10, some.shape), 0)


@pytest.mark.parametrize("grid", ["true", "loose", "wrong", "faint"])
def test_the_mean_over_shifts_is_the_optical_depth(grid: str) -> None:
    """Bounds that are σ, 40 times it with a margin, of other cells, or next to nothing: they tell where samples are dense."""
    sigma = blocks(0)
    bound = {"true": sigma, "loose": 40 * sigma + 0.1, "wrong": 40 * blocks(1) + 1e-6, "faint": 0 * sigma + 1e-6}[grid]
    o, d = rays(24, 2)
    many = ray(np.repeat(o, SHIFTS, axis=0), np.repeat(d, SHIFTS, axis=0))
    shifts = mi.Float(np.tile((np.arange(SHIFTS) + 0.5) / SHIFTS, len(o)).astype(np.float32))
    flight = fly(context(Blocks(sigma, bound)), many, dr.inf, dr.full(mi.Bool, True, len(o) * SHIFTS), shifts)
    mean = np.array(flight.depth).reshape(-1, SHIFTS).mean(axis=1)
    expected = np.array([true_depth(sigma, *x) for x in zip(o, d, strict=True)])
    assert (expected > 0.2).sum() > 15
    np.testing.assert_allclose(mean, expected, rtol=0.01, atol=0.02)


def test_most_samples_lie_where_light_is_lost() -> None:
    """A wall of one row of cells in thin air, straight through: half of the samples, and what its thickness is due."""
    bound = np.full((SIDE * CELLS, SIDE * CELLS, CELLS), 1e-3)
    bound[:, :, 4] = 1e3
    o = np.array([[0.7, 0.2, 3.0]]) + np.arange(64)[:, None] / 100
    d = np.tile([[0.0, 0.0, -1.0]], (64, 1))
    shifts = mi.Float(((np.arange(64) + 0.5) / 64).astype(np.float32))
    medium, every = Blocks(0 * bound, bound), dr.full(mi.Bool, True, 64)

    def evaluated(skip: float) -> float:
        return np.array(fly(context(medium, samples=40, skip=skip), ray(o, d), dr.inf, every, shifts).queries).mean()

    wall, all_ = evaluated(0.5), evaluated(0.0)
    lost = -np.expm1(-0.025 * 1e3 / CELLS)
    assert abs(wall - 40 * (0.5 * lost + (0.4 + 0.1) / CELLS)) < 0.1
    assert abs(all_ - wall - 40 * 0.1 * (1 - 1 / CELLS)) < 0.1


def test_a_sample_stands_for_no_more_than_it_may() -> None:
    """In empty space a ray of canonical length ℓ has S ℓ / WIDEST samples."""
    o, d = rays(200, 3)
    nothing = np.zeros((SIDE * CELLS, SIDE * CELLS, CELLS))
    shifts = mi.Float(np.random.default_rng(0).random(200).astype(np.float32))
    flight = fly(context(Blocks(nothing, nothing), skip=0.0), ray(o, d), dr.inf, dr.full(mi.Bool, True, 200), shifts)
    assert (np.array(flight.queries) == 0).all()  # what is bounded by 0 is not evaluated
    faint = nothing + 1e-6
    flight = fly(context(Blocks(faint, faint)), ray(o, d), dr.inf, dr.full(mi.Bool, True, 200), shifts)
    length = np.array([true_depth(nothing + 1, *x) for x in zip(o, d, strict=True)])
    expected = 20 * length / WIDEST
    assert (np.abs(np.array(flight.queries) - expected) <= 1.01).all()


@pytest.mark.parametrize("first", [0, 4096, 10**6])
def test_far_from_the_textures_origin_rays_end(first: int) -> None:
    """At 10⁶ patches a float32 has a step of half a cell."""
    sigma = blocks(4)
    o, d = rays(500, 5)
    flight = fly(context(Blocks(sigma, 4 * sigma, first)), ray(o, d), dr.inf, dr.full(mi.Bool, True, 500))
    queries, depth = np.array(flight.queries), np.array(flight.depth)
    assert queries.max() < 400 and np.isfinite(depth).all()
    expected = np.array([true_depth(sigma, *x) for x in zip(o, d, strict=True)])
    assert abs(depth.mean() / expected.mean() - 1) < 0.1


@pytest.mark.parametrize("bound", [0.0, 1e-30, 1e30, np.inf])
def test_any_bound(bound: float) -> None:
    sigma = blocks(6)
    o, d = rays(50, 7)
    every = np.full_like(sigma, bound)
    flight = fly(context(Blocks(sigma, every)), ray(o, d), dr.inf, dr.full(mi.Bool, True, 50))
    assert np.isfinite(np.array(flight.depth)).all() and np.array(flight.queries).max() < 400
