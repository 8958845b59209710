"""What cannot be scored is said in one line; what was scored is written into what is exported."""

import json
from pathlib import Path

import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.measure.evaluation import FILE, evaluation, with_scores
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.gan.state import GanConfig
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
