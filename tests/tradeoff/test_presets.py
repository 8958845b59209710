"""The presets are points on the front of several scenes together, which `benchmarks/presets.py` measured."""

import json
from pathlib import Path

import pytest

from mesoshell.render.quality import PRESETS

MEASURED = json.loads((Path(__file__).parents[2] / "benchmarks/presets.json").read_text())
#: Share by which a preset may cost more than the cheapest settings of no more error: presets change pictures, so not for less.
ALLOWED = 1.1


@pytest.mark.parametrize("name", ["draft", "normal"])
def test_a_preset_lies_on_the_front(name: str):
    counts, points = MEASURED["counts"], MEASURED["points"]
    preset, knobs = PRESETS[name], points[0]["settings"]
    (own,) = (p for p in points if p["settings"] == {knob: getattr(preset, knob) for knob in knobs})
    error = own["flip"][counts.index(preset.pixel_samples)]
    at_most = [n * p["cost"] for p in points for n, flip in zip(counts, p["flip"], strict=True) if flip <= error]
    assert len(points) > 30 and preset.pixel_samples * own["cost"] <= ALLOWED * min(at_most)


def test_reference_is_the_most_accurate():
    settings = {knob: getattr(PRESETS["reference"], knob) for knob in MEASURED["points"][0]["settings"]}
    (own,) = (p for p in MEASURED["points"] if p["settings"] == settings)
    assert own["flip"][-1] == min(p["flip"][-1] for p in MEASURED["points"])
