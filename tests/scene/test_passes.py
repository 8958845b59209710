"""Passes of each engine and kind of material: pixels may be left out, and their mean is the picture."""

from pathlib import Path

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.io.bundle import Bundle
from mesoshell.render.quality import PRESETS
from mesoshell.scene.accumulate import Goal
from mesoshell.scene.materials import Material
from mesoshell.scene.picture import Prepared
from mesoshell.scene.prepare import prepare
from mesoshell.scene.reach import picture_of
from tests.helpers import wearing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
SIZE = 20, 16
PIXELS = SIZE[0] * SIZE[1]
QUALITY = PRESETS["draft"].with_changes(pixel_samples=16, spp=64, max_depth=2)
SOME = np.flatnonzero(np.random.default_rng(0).uniform(size=PIXELS) < 0.4)


#: The slow one is of the march's passes by another material, whose command is tested.
EACH = ["jax-shell", pytest.param("jax-surface", marks=pytest.mark.slow), "mitsuba-shell", "mitsuba-surface"]


@pytest.fixture(scope="module", params=EACH)
def ready(request, tiny_bundle: Bundle) -> Prepared:
    engine, kind = request.param.split("-")
    material = Material("tiny", tiny_bundle) if kind == "shell" else Material("dots", wearing.bundle())
    return prepare(ms.Scene(MESH, material, scale=0.4, size=SIZE), QUALITY, engine)


def test_chosen_pixels_are_as_in_the_whole_pass(ready: Prepared) -> None:
    passes = ready.passes(None)
    assert passes.chosen and passes.shape == SIZE[::-1]
    whole = passes.render(3, np.arange(PIXELS), lambda share: None)
    assert whole.shape == (PIXELS, 4) and whole[:, 3].max() > 0.5
    np.testing.assert_allclose(passes.render(3, SOME, lambda share: None), whole[SOME], atol=1e-6)
    np.testing.assert_allclose(passes.render(3, np.arange(PIXELS), lambda share: None), whole, atol=1e-6)
    assert np.abs(passes.render(4, np.arange(PIXELS), lambda share: None) - whole).max() > 1e-3


def reached(ready: Prepared, samples: int | None) -> ms.Picture:
    goal = None if samples is None else Goal(max_samples=samples)
    return picture_of(ready, QUALITY, goal, True, lambda share: None)


def test_their_mean_is_the_picture(ready: Prepared) -> None:
    """To the noise of both, of which paths have more."""
    most = 32 if ready.engine == "mitsuba" else 16
    made, one, few, plain = (reached(ready, n) for n in (most, 1, most // 4, None))
    far, near, other = (np.abs(x.rgba - made.rgba).mean() for x in (one, few, plain))
    assert near < 0.7 * far and other < 0.7 * far
    assert abs((plain.rgba - made.rgba).mean()) < 0.12 * made.rgba.mean()
    used = made.report["quality"]
    assert used.get("pixel_samples", used.get("spp")) == most
    assert made.report["rays"] >= most * PIXELS and made.report["goal"]["met"] == "max_samples"


def test_passes_take_another_quality(ready: Prepared) -> None:
    """And leave the picture of the first as it was."""
    other = PRESETS["normal"].with_changes(samples=7, light_samples=0, early_stop=0.2, max_depth=2)
    passes = ready.passes(other)
    image = passes.render(0, np.arange(PIXELS), lambda share: None).reshape(*SIZE[::-1], 4)
    record = passes.ended(image, 1).record
    used = record["quality"]
    assert used.get("samples", 7) == 7 and used.get("early_stop", 0.2) == 0.2 and used.get("max_depth", 2) == 2
    back = ready.passes(None)
    assert back.ended(image, 1).record["quality"].get("samples", QUALITY.samples) == QUALITY.samples
