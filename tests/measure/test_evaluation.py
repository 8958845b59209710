"""What cannot be scored is said in one line; what was scored is written into what is exported."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mesoshell.cli.commands.evaluate import _check_parameters
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.measure.evaluation import FILE, evaluation, with_scores
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.nerf_tex.seeds import SEED
from tests.helpers import fog


def test_a_run_without_pictures_is_not_evaluated() -> None:
    with pytest.raises(InputError, match=r"^run: cannot be evaluated"):
        evaluation(FitConfig(), None, Path("run"), 4)


def test_too_few_pictures_are_not_compared(tmp_path: Path) -> None:
    few = fog.write(tmp_path / "fog", fog.CAMERAS[:3], size=8)
    with pytest.raises(InputError, match="has 3 images: at least 4 are compared"):
        evaluation(GanConfig(), few, Path("run"), 100)


def test_a_snapshot_takes_its_own_scores_along(tiny_bundle: Bundle, tmp_path: Path) -> None:
    rows = [{"name": "KID", "value": value, "kimg": kimg} for value, kimg in ((0.5, 8), (0.25, 16))]
    (tmp_path / FILE).write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert with_scores(tiny_bundle, tmp_path, 16000).provenance["metrics"] == {"KID": 0.25}
    assert with_scores(tiny_bundle, tmp_path / "none", 16000).provenance["metrics"] == {}


def test_data_of_other_parameters_are_refused(tmp_path: Path) -> None:
    """A seed of geometry, which a network learns beside them, is none of them."""
    data = fog.write(tmp_path / "fog", fog.CAMERAS, size=8)
    seeded = replace(data, manifest=data.manifest | {"parameters": data.manifest["parameters"] | {SEED: {}}})
    known = {"parameters": data.manifest["parameters"], "fixed_parameters": {}}
    _check_parameters(NerfTexConfig(), known, NerfTexConfig(), seeded)
    _check_parameters(GanConfig(), known, GanConfig(), data)
    with pytest.raises(InputError, match="varies the parameters age; the run was begun with none"):
        _check_parameters(GanConfig(), known | {"fixed_parameters": {"age": 0.2}}, GanConfig(), data)
    with pytest.raises(InputError, match="varies the parameters age; the run was begun with others"):
        _check_parameters(GanConfig(), {}, GanConfig(appearance=1), data)
