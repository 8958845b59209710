"""Quality: every value out of range is refused by name, and presets are ordered."""

from dataclasses import fields

import pytest

from mesoshell.render.quality import PRESETS, SETTINGS, Quality, kind_of, out_of_range, range_of, wrong_kind

BAD = {
    "pixel_samples": 0,
    "samples": -1,
    "spacing": "even",
    "height_filter": 2.0,
    "coordinates": "newton",
    "density": "voxels",
    "early_stop": 1.0,
    "skip": -0.1,
    "weight_cut": float("nan"),
    "light_samples": -1,
    "footprint": 4.0,
    "anisotropy": 0,
    "visibility": "never",
    "environment_samples": 0,
    "base_samples": 0,
    "bounce_spread": 1.0,
    "twin": 1.0,
    "spp": 0,
    "max_depth": 0,
    "rr_depth": 0,
    "dark_ground": -0.1,
    "curvature_filter": "median",
    "curve_length": -1.0,
}


@pytest.mark.parametrize("name", BAD)
def test_values_out_of_range_are_refused_by_name(name: str):
    with pytest.raises(ValueError, match=name):
        Quality(**{name: BAD[name]})


def test_every_field_but_the_switch_is_checked():
    assert {f.name for f in fields(Quality)} == BAD.keys() | {"filtering"}


def test_all_faults_are_said_at_once():
    with pytest.raises(ValueError, match=r"samples must be at least 1; skip must lie in \[0, 1\)"):
        Quality(samples=0, skip=2.0)


def test_changes_are_checked_too():
    assert Quality().with_changes(samples=7).samples == 7
    with pytest.raises(ValueError, match="samples"):
        Quality().with_changes(samples=0)


def test_presets_spend_ever_more():
    draft, normal, reference = (PRESETS[k] for k in ("draft", "normal", "reference"))
    for cheap, dear in ((draft, normal), (normal, reference)):
        for name in (
            "pixel_samples",
            "samples",
            "anisotropy",
            "environment_samples",
            "base_samples",
            "spp",
            "max_depth",
        ):
            assert getattr(cheap, name) <= getattr(dear, name)
        for name in ("early_stop", "skip", "weight_cut", "footprint", "dark_ground", "bounce_spread"):
            assert getattr(cheap, name) >= getattr(dear, name)
    assert (reference.early_stop, reference.skip, reference.weight_cut) == (0, 0, 0)


def test_more_samples_leave_no_more_unlit():
    assert Quality().least_weight == pytest.approx(0.048 / 28)
    for samples in (1, 48, 4096):
        assert samples * Quality(samples=samples).least_weight == pytest.approx(Quality().weight_cut)


def test_the_record_names_every_field():
    assert Quality().as_dict().keys() == {f.name for f in fields(Quality)}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_says_what_it_is_and_its_range_holds_its_presets(name: str):
    setting = SETTINGS[name]
    assert setting.meaning and setting.engine in ("", "jax", "mitsuba")
    for preset in PRESETS.values():
        value = getattr(preset, name)
        assert not wrong_kind(name, value) and not out_of_range(name, value)
        assert kind_of(name) is bool or str(value) in range_of(name) or value >= setting.least
    assert wrong_kind(name, None) and wrong_kind(name, [])
    assert (wrong_kind(name, True) == "") == (kind_of(name) is bool)
