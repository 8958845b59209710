"""What is measured next."""

import numpy as np

from mesoshell.render.quality import PRESETS, Quality, out_of_range, wrong_kind
from mesoshell.tradeoff.front import entries, front
from mesoshell.tradeoff.knobs import VALUES, changes, describe_changes, knobs_of, neighbours, settings_of
from mesoshell.tradeoff.points import Point, combined_error
from mesoshell.tradeoff.search import around, propose, singles

NAMES = ("samples", "early_stop", "anisotropy")


def test_every_knob_is_a_field_with_values_of_every_preset() -> None:
    counted = {"pixel_samples", "spp"}
    assert set(VALUES) | counted == set(Quality().as_dict())
    for name, values in VALUES.items():
        assert all(not wrong_kind(name, x) and not out_of_range(name, x) for x in values)
        assert len(set(values)) == len(values) > 1
        assert all(getattr(preset, name) in values for preset in PRESETS.values())


def test_only_what_a_picture_depends_on_is_varied() -> None:
    assert knobs_of(["anisotropy", "samples", "spp"]) == ("samples", "anisotropy")
    assert knobs_of(["samples", "max_depth"], ["max_depth"]) == ("samples",)


def test_singles_hold_the_presets_and_change_one_knob() -> None:
    found = list(singles(NAMES))
    for preset in PRESETS.values():
        assert settings_of(preset, NAMES) in found
    presets = [settings_of(preset, NAMES) for preset in PRESETS.values()]
    assert all(len(changes(s)) <= 1 for s in found if s not in presets)
    assert all(s[k] in VALUES[k] for s in [*found, *around(NAMES)] for k in NAMES)
    normal = settings_of(PRESETS["normal"], NAMES)
    assert {"samples": 40, "anisotropy": 2, "early_stop": 0.005} in list(neighbours(normal))
    assert describe_changes(normal) == "normal" and describe_changes({**normal, "samples": 56}) == "samples 56"


def test_filters_vary_only_where_density_is_the_networks() -> None:
    """A baked one is read without; its own settings stay as they are."""
    names = ("samples", "density", "filtering", "footprint")
    normal = settings_of(PRESETS["normal"], names)
    assert normal["filtering"] and normal["density"] == "baked" and describe_changes(normal) == "normal"
    near = list(neighbours(normal))
    assert {k for s in near for k in names if s[k] != normal[k]} == {"samples", "density"}
    (network,) = (s for s in near if s["density"] == "network")
    assert {k for s in neighbours(network) for k in names if s[k] != network[k]} == set(names)


def test_what_does_nothing_without_a_filter_does_not_vary() -> None:
    names = ("samples", "filtering", "footprint", "anisotropy")
    reference = settings_of(PRESETS["reference"], names)
    near = list(neighbours(reference))
    assert all(s["samples"] != 256 or s["filtering"] for s in near) and len(near) == 2
    normal = settings_of(PRESETS["normal"], names)
    (off,) = (s for s in neighbours(normal) if not s["filtering"])
    assert off == {**reference, "samples": normal["samples"]}
    assert describe_changes(off) == "filtering False" and {**normal, "footprint": 0.35} in list(neighbours(normal))


def engine(settings) -> Point:
    """A made-up engine: costs multiply, squares of biases add, and one knob costs nothing."""
    t = settings["samples"] / 48 * {1: 1.0, 2: 1.02, 4: 1.05, 8: 1.5, 16: 2.5}[settings["anisotropy"]]
    b = np.hypot(1.5 / settings["samples"], 0.05 / settings["anisotropy"] ** 2)
    counts = (1, 2, 4, 8)
    e = tuple(float(combined_error(b, 0.03, n)) for n in counts)
    zeros = (0.0,) * 4
    return Point(dict(settings), (t, t, t), 0.0, t, counts, e, zeros, zeros, float(b), 0.03, 0.0, 0.0)


def test_proposals_find_the_front_of_all_settings() -> None:
    names = ("samples", "anisotropy")
    points = [engine(s) for s in singles(names)]
    best = front(
        entries(engine({"samples": s, "anisotropy": a}) for s in VALUES["samples"] for a in VALUES["anisotropy"])
    )
    for _ in range(30):
        settings = propose(points)
        if settings is None:
            break
        assert settings not in [p.settings for p in points]
        points.append(engine(settings))
    found = front(entries(points))
    draft = engine(settings_of(PRESETS["draft"], names)).flip[0]
    for e in (e for e in best if e.flip <= draft):
        assert any(k.seconds <= 1.15 * e.seconds and k.flip <= 1.15 * e.flip for k in found), e
    assert len(points) < 0.75 * len(VALUES["samples"]) * len(VALUES["anisotropy"])
