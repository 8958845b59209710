"""Geometry of the recipes, without Blender: finite, in the slab, dense everywhere, periodic, and drawn by the seed alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_gen import scatter
from data_gen.recipe import TOP
from data_gen.worker import RECIPES

NAMES = sorted(RECIPES)
#: The carpet with fewer parameters: the same blades by the same code.
RESTRICTED = ("carpet2", "carpet4", "carpet6", "carpet")
EACH = [pytest.param(name, marks=pytest.mark.slow if name in RESTRICTED else ()) for name in NAMES]


def grown(name: str, seed: int = 0, side: int = 3, **values: float):
    recipe = RECIPES[name]
    default = {key: parameter.default for key, parameter in recipe.parameters.items()}
    return recipe.grow(np.random.default_rng(seed), side, default | values)


@pytest.mark.parametrize("name", EACH)
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_any_parameters_grow_something_finite_in_the_slab(name, data):
    values = {key: data.draw(st.floats(*p.range), label=key) for key, p in RECIPES[name].parameters.items()}
    growth = grown(name, data.draw(st.integers(0, 2**53)), 3, **values)
    assert np.isfinite(growth.points).all()
    heights = growth.points[..., 2]
    assert heights.min() >= 0 and heights.max() <= TOP
    assert growth.points[..., :2].min() > -1.2 and growth.points[..., :2].max() < 4.2, "a strand may lean one patch"
    assert growth.elements.max() == growth.points.shape[1] - 1
    assert growth.along[0] == 0 and growth.along[-1] == 1
    for values in growth.own.values():
        assert values.shape == growth.points.shape[:1] and values.min() >= 0 and values.max() <= 1
    if growth.radius is not None:
        assert growth.radius.shape == growth.points.shape[:2] and 0 < growth.radius.min() < growth.radius.max() < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_every_patch_of_the_slab_has_the_same_number_of_roots(name):
    growth = grown(name)
    root = growth.points[:, :2].mean(axis=1) if growth.radius is None else growth.points[:, 0]
    patch = np.clip(np.floor(root[:, :2]).astype(int), 0, 2)
    counts = np.bincount(patch[:, 0] * 3 + patch[:, 1], minlength=9)
    assert counts.min() > 0.97 * counts.max()


@pytest.mark.parametrize("name", EACH)
def test_the_seed_decides(name):
    np.testing.assert_array_equal(grown(name, 5).points, grown(name, 5).points)
    assert not np.array_equal(grown(name, 5).points, grown(name, 6).points)


def test_a_patch_is_periodic():
    """What leaves a torus of one patch at one side comes in at the other: the fields that bend strands agree there."""
    rng = np.random.default_rng(0)
    points = rng.random((50, 2))
    for side in (1, 3):
        here = scatter.field(points, side, np.random.default_rng(1), (0.6, 1.7))
        np.testing.assert_allclose(
            here, scatter.field(points + side, side, np.random.default_rng(1), (0.6, 1.7)), atol=1e-12
        )
        centres = side * rng.random((20, 2))
        index, way = scatter.nearest(points, centres, side)
        again, same = scatter.nearest(points + np.array([side, 0]), centres, side)
        np.testing.assert_array_equal(index, again)
        np.testing.assert_allclose(way, same, atol=1e-12)
        assert np.abs(way).max() <= side / 2


def test_nearest_agrees_with_all_nine_copies():
    rng = np.random.default_rng(2)
    points, centres = rng.random((200, 2)), rng.random((13, 2))
    index, way = scatter.nearest(points, centres, 1)
    offsets = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 1, 2)
    apart = (centres + offsets).reshape(-1, 2)[None] - points[:, None]
    best = np.linalg.norm(apart, axis=-1).argmin(axis=1)
    np.testing.assert_array_equal(index, best % 13)
    np.testing.assert_allclose(way, apart[np.arange(200), best], atol=1e-12)


@pytest.mark.parametrize("a_patch", [1, 30, 64, 150])
def test_a_jittered_grid_is_even(a_patch):
    points = scatter.jittered_grid(a_patch, 3, np.random.default_rng(0))
    assert points.shape == (9 * a_patch, 2) and points.min() >= 0 and points.max() < 3
    cells = int(np.ceil(np.sqrt(a_patch)))
    cell = np.floor(points * cells).astype(int)
    assert len({tuple(c) for c in cell}) == len(points), "two points in one cell"


def test_length_is_the_length_along_the_axis():
    """The pile's height at no lean is its length, and combing it down keeps the axis as long."""
    upright, combed = (grown("carpet8", length=0.8, roughness=0.0, braiding=0.0, lean=lean) for lean in (0.0, 1.0))
    assert upright.points[..., 2].max() == pytest.approx(0.8, rel=0.03)

    def axes(growth):
        return growth.points.reshape(-1, 21, *growth.points.shape[1:]).mean(axis=1)

    def length(growth):
        return np.linalg.norm(np.diff(axes(growth), axis=1), axis=-1).sum(axis=1).mean()

    assert length(combed) == pytest.approx(length(upright), rel=0.02)
    s = np.linspace(0, 1, 1001)
    assert axes(combed)[..., 2].max(axis=1).mean() / axes(upright)[..., 2].max(axis=1).mean() == pytest.approx(
        np.cos(0.25 + 0.75 * np.sqrt(s)).mean(), rel=0.03
    )


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, 2.5])
def test_the_pile_leans_where_it_is_combed(angle):
    points = grown("carpet8", lean=0.8, lean_angle=angle, roughness=0.0).points
    lean = (points[:, -1, :2] - points[:, 0, :2]).mean(axis=0)
    assert np.angle(np.exp(1j * (np.arctan2(lean[1], lean[0]) - angle))) == pytest.approx(0.0, abs=0.05)


def test_density_is_the_share_of_tufts():
    whole = len(grown("carpet8", density=1.0).points)
    assert len(grown("carpet8", density=0.5).points) / whole == pytest.approx(0.5, abs=0.08)


def test_subsets_are_the_carpet_at_defaults():
    for name in ("carpet2", "carpet4", "carpet6", "carpet"):
        assert int(name.removeprefix("carpet") or 7) == len(RECIPES[name].parameters)
        np.testing.assert_array_equal(grown(name).points, grown("carpet8").points)
