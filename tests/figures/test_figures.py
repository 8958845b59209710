"""The papers' figures, at the size of a stamp: each script draws, and the page shows what each writes. Their real sizes take
minutes each."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mesoshell as ms
from experiments.figures import known_phases, sheet

ROOT = Path(__file__).parents[2]
FIGURES = ROOT / "experiments/figures"
SCRIPTS = sorted(p.stem for p in FIGURES.glob("*.py") if "def main" in p.read_text())
WRITTEN = {p.stem: re.findall(r'draw\(\s*"(\w+)"', p.read_text()) for p in FIGURES.glob("*.py")}


def test_the_page_shows_what_is_drawn():
    page = (ROOT / "docs/results/figures.md").read_text()
    assert set(re.findall(r"images/figures/(\w+)\.png", page)) == {name for some in WRITTEN.values() for name in some}
    assert set(re.findall(r"-m experiments\.figures\.(\w+)", page)) == set(SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_says_what_it_draws(name: str):
    module = importlib.import_module(f"experiments.figures.{name}")
    assert f"python -m experiments.figures.{name}" in str(module.__doc__)


def test_a_sheet_has_its_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    monkeypatch.setattr(sheet, "OUT", tmp_path)
    red, grey = np.zeros((8, 8, 3)), np.full((8, 8), 0.5)
    red[..., 0] = 1
    path = sheet.draw("a", [[red, grey], [grey, red]], ("left", "right"), ("upper", "lower"))
    assert capsys.readouterr().out == f"{path}\n"
    found = np.asarray(Image.open(path).convert("RGB")).astype(int)
    redness = (found[..., 0] > 250) & (found[..., 1] < 5)
    assert 0.2 < redness.mean() < 0.5
    high, wide = redness.shape
    assert redness[: high // 2, : wide // 2].any() and not redness[high * 3 // 4 :, : wide // 3].any()


def test_over_white():
    clear = sheet.over_white(np.zeros((2, 2, 4)))
    np.testing.assert_allclose(clear, np.ones((2, 2, 3)))


@pytest.mark.slow
def test_a_learned_patch_is_grass_and_the_next_is_not(monkeypatch: pytest.MonkeyPatch):
    """From above, the patch that was learned is nearer to its exemplar than any other patch of the texture."""
    monkeypatch.chdir(ROOT)
    made = known_phases.learned((1, 2))
    with np.load("materials/grass_exemplars.npz") as file:
        exemplar = file["features"][0].astype(np.float32)
    feature = made.shell.arrays["features/0"].astype(np.float32)
    side = len(exemplar)
    apart = [np.mean((feature[:, k * side : (k + 1) * side] - exemplar) ** 2) for k in (0, 1)]
    assert apart[0] < 0.6 * apart[1]


@pytest.mark.slow
def test_maps_and_textures_follow_a_seed():
    module = importlib.import_module("experiments.figures.mesogan_4")
    maker = module.generator_model(ms.load_material("lawn").shell, "lawn")
    one, same, other = module.inputs(maker, 1), module.inputs(maker, 1), module.inputs(maker, 2)
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.5
    assert module.texture(maker, 1).shape[:2] == (module.PATCHES * maker.config.texels,) * 2
