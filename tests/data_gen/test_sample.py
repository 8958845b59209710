"""Draws of a sample: from its index alone, in their ranges, and spread as promised."""

import numpy as np
import pytest
from scipy import stats

from data_gen import sample
from data_gen.worker import RECIPES


def drawer(recipe: str = "carpet8", seed: int = 0, patch: int | None = None, **fixed: float) -> sample.Drawer:
    return sample.Drawer(RECIPES[recipe], seed, sample.default_coverage(128), fixed, patch)


def test_a_sample_depends_on_recipe_seed_and_index_alone():
    a, b = drawer().draw(17), drawer().draw(17)
    assert a.parameters == b.parameters and a.instance == b.instance and a.cycles_seed == b.cycles_seed
    np.testing.assert_array_equal(a.camera_to_world, b.camera_to_world)
    others = [drawer().draw(18), drawer(seed=1).draw(17), drawer("carpet").draw(17)]
    assert len({x.instance for x in [a, *others]}) == 4 and len({tuple(x.light) for x in [a, *others]}) == 4


def test_known_values():
    """The hash is part of the contract: what it draws today it draws in every version of this recipe."""
    drawn = sample.Drawer(RECIPES["grass"], 0, sample.default_coverage(128), {}, None).draw(0)
    assert (drawn.cycles_seed, drawn.instance) == (429008096, 3396447029740336)
    assert drawn.parameters["age"] == 0.7255759432135666


def test_fixing_a_parameter_leaves_all_else():
    free, fixed = drawer().draw(3), drawer(length=0.4).draw(3)
    assert fixed.parameters == {**free.parameters, "length": 0.4}
    assert (fixed.instance, fixed.radius, fixed.cycles_seed) == (free.instance, free.radius, free.cycles_seed)


def test_a_patch_is_one_instance_on_a_torus_of_one():
    assert {(drawer(patch=9).draw(i).instance, drawer(patch=9).draw(i).side) for i in range(5)} == {(9, 1)}
    assert {drawer().draw(i).side for i in range(5)} == {3}


def many(seed: int = 0, views: int = 4, **fixed: float) -> sample.Drawer:
    return sample.Drawer(RECIPES["carpet8"], seed, sample.default_coverage(128), fixed, None, views)


def test_many_patches_come_one_after_the_other_each_with_a_geometry_of_its_own():
    roles = {name: parameter.role for name, parameter in RECIPES["carpet8"].parameters.items()}
    draws = [many().draw(i) for i in range(12)]
    assert [d.instance for d in draws] == [0] * 4 + [1] * 4 + [2] * 4 and {d.side for d in draws} == {1}
    for name, role in roles.items():
        values = [d.parameters[name] for d in draws]
        assert len(set(values)) == (12 if role == "alpha" else 3), name
        assert role == "alpha" or values[0] == values[3] != values[4]
    assert len({tuple(d.light) for d in draws}) == 12 and len({d.cycles_seed for d in draws}) == 12


def test_patches_are_the_same_for_other_seeds_and_numbers_of_views():
    def shape(drawn: sample.Sample) -> tuple:
        kept = [v for n, v in drawn.parameters.items() if RECIPES["carpet8"].parameters[n].role == "beta"]
        return drawn.instance, *kept

    assert shape(many().draw(9)) == shape(many(seed=5).draw(8)) == shape(many(views=2).draw(5))
    assert not np.array_equal(many().draw(9).light, many(seed=5).draw(9).light)
    fixed = many(length=0.4).draw(9).parameters
    assert fixed == {**many().draw(9).parameters, "length": 0.4}


def test_distributions():
    draws = [drawer().draw(i) for i in range(2000)]
    for name, parameter in RECIPES["carpet8"].parameters.items():
        values = np.array([d.parameters[name] for d in draws])
        low, high = parameter.range
        assert stats.kstest((values - low) / (high - low), "uniform").pvalue > 1e-3, name
    for of, elevation in (("light", sample.LIGHT_ELEVATION), ("camera", sample.CAMERA_ELEVATION)):
        way = np.array([d.light if of == "light" else d.camera_to_world[:3, 2] for d in draws])
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1, atol=1e-12)
        low = np.sin(elevation)
        assert stats.kstest((way[:, 2] - low) / (1 - low), "uniform").pvalue > 1e-3, "uniform in solid angle"
        azimuth = np.arctan2(way[:, 1], way[:, 0]) / (2 * np.pi) % 1
        assert stats.kstest(azimuth, "uniform").pvalue > 1e-3
    coverage = np.array([1 / (2 * d.radius * np.tan(sample.FIELD_OF_VIEW / 2)) for d in draws])
    assert coverage.min() >= 8 / 128 and coverage.max() <= 2
    assert np.mean(coverage > sample.LARGE_COVERAGE) == pytest.approx(sample.LARGE_SHARE, abs=0.03)


def test_cameras_look_at_the_centre():
    for i in range(50):
        pose = drawer().draw(i)
        m = pose.camera_to_world
        np.testing.assert_allclose(m[:3, :3] @ m[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(m[:3, :3]) == pytest.approx(1)
        np.testing.assert_allclose(m[:3, 3] - pose.radius * m[:3, 2], [0.5, 0.5, 0.5], atol=1e-9)
