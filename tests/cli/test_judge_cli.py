"""`mesoshell judge` as a user calls it: a blind sheet, its marks, and scores; and one line for each fault."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.commands import judge_scores
from mesoshell.cli.main import main
from mesoshell.io.bundle import write_bundle
from mesoshell.io.image import read_png
from mesoshell.measure import fields, posed
from mesoshell.measure.features import Extractor
from mesoshell.train.gan.presets import TINY
from mesoshell.train.run_config import keep_record
from tests.helpers import fog, growing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("judge_cli")


@pytest.fixture(scope="module")
def made(tmp_path_factory, tiny_bundle) -> Path:
    """A dataset, a fitted patch, a generator, and a run whose snapshot it is."""
    folder = tmp_path_factory.mktemp("judged")
    data = fog.write(folder / "fog", [(0.6, 0.3, 1.6 + 0.2 * k) for k in range(12)], size=8)
    write_bundle(folder / "patch.npz", tiny_bundle)
    generator = growing.bundle()
    write_bundle(folder / "made.npz", generator)
    taken = replace(TINY.picture, size=8, samples=4, texels=16, height_rows=8, octaves=1)
    keep_record(replace(TINY, picture=taken), data, folder / "run")
    (folder / "run" / "snapshots").mkdir()
    write_bundle(folder / "run" / "snapshots" / "000000008.npz", generator)
    return folder


@pytest.fixture(autouse=True)
def _small(monkeypatch, tmp_path_factory):
    monkeypatch.setattr(posed, "SAMPLES", 8)
    monkeypatch.setattr(posed, "BATCH", 4)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def fault(capsys, *arguments: object) -> str:
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main(["judge", *(str(a) for a in arguments)])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


def test_a_blind_sheet_and_its_marks(made, tmp_path, capsys) -> None:
    out = tmp_path / "blind"
    given = ["judge", "blind", str(made / "run"), "--data", str(made / "fog"), "--out", str(out), "--count", "4"]
    main(given)
    assert sorted(p.name for p in out.iterdir()) == ["answers.json", "sheet.png"]
    assert read_png(out / "sheet.png").shape[:2] == (132, 8 * 130 + 2)  # 8 pictures, of 8 pixels enlarged 16 times
    answers = json.loads((out / "answers.json").read_text())
    assert sorted(answers["answer"]) == ["m"] * 4 + ["r"] * 4
    shown = list(zip(answers["answer"], answers["samples"], strict=True))
    assert {i for x, i in shown if x == "r"} == {i for x, i in shown if x == "m"}  # the same cameras
    (tmp_path / "knows.txt").write_text(answers["answer"])
    (tmp_path / "errs.txt").write_text("r m " * 2 + "\n" + "RM" * 2)
    capsys.readouterr()
    main(["judge", "marks", str(out), str(tmp_path / "knows.txt"), str(tmp_path / "errs.txt")])
    said = capsys.readouterr().out
    assert "knows.txt | 8 of 8 | 100% | 63% to 100% | 0.0039 |" in said
    kept = json.loads((out / "judged.json").read_text())
    wrong = sum(a != b for a, b in zip(answers["answer"], "rmrmrmrm", strict=True))
    assert kept[str(tmp_path / "errs.txt")]["right"] == 8 - wrong
    main([*given[:-4], "--out", str(tmp_path / "beside"), "--count", "4", "--against", str(made / "patch.npz")])
    beside = json.loads((tmp_path / "beside" / "answers.json").read_text())
    assert beside["answer"] == answers["answer"] and beside["real"].endswith("patch.npz")
    assert (tmp_path / "beside" / "sheet.png").read_bytes() != (out / "sheet.png").read_bytes()


def test_scores_stand_in_one_table(made, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(fields, "FIELD", (2, 6))
    monkeypatch.setattr(fields, "PATCH", 8)
    monkeypatch.setattr(fields, "SEEDS", 1)
    monkeypatch.setattr(fields, "SIDE", 2)
    colour = Extractor("Colour", lambda image: image[..., :3].mean(axis=(1, 2)))
    monkeypatch.setattr(judge_scores, "_networks", lambda console: [colour])
    patch, generator, out = made / "patch.npz", made / "made.npz", tmp_path / "scores"
    materials = [str(patch), str(generator)]
    main(["judge", "scores", *materials, "--data", str(made / "fog"), "--out", str(out), "--exemplars", *materials[:1]])
    printed = capsys.readouterr().out
    assert printed == (out / "scores.md").read_text()
    found = json.loads((out / "scores.json").read_text())["scores"]
    assert list(found) == ["renders", *materials]
    assert list(found["renders"]) == ["KID-Colour", "SWD-8", "read age"]
    assert list(found[materials[0]])[:5] == ["KID-Colour", "SWD-8", "read age", "opacity", "light"]
    assert "| opacity |  | " in printed and "| 0.95 to 1.05 |" in printed
    assert found[materials[0]]["nearest exemplar"]["value"] == pytest.approx(0, abs=1e-6)
    assert found[materials[1]]["nearest exemplar"]["value"] > 0.5
    assert found[materials[0]]["repeat"]["value"] == pytest.approx(1, abs=1e-4)
    for name in ("made", "patch"):
        assert read_png(out / f"field_{name}.png").shape == (12, 12, 3)
        assert np.ptp(read_png(out / f"nearest_{name}.png")) > 0


def test_each_fault_is_one_line_and_nothing_is_written(made, tmp_path, capsys) -> None:
    data, out, patch = made / "fog", tmp_path / "out", made / "patch.npz"
    blind = ("--data", data, "--out", out, "--count", 4)
    assert "no such material" in fault(capsys, "blind", "nothing", *blind)
    assert "must be from 1 to the dataset's 12" in fault(capsys, "blind", patch, *blind[:-1], 13)
    assert "--seed: -1 must be from 0" in fault(capsys, "blind", patch, *blind, "--seed", -1)
    small = fog.write(tmp_path.parent / "small", [(0.6, 0.3, 1.6)] * 12, size=6).folder
    assert "fewer than 7 pixels" in fault(capsys, "scores", patch, "--data", small, "--out", out)
    assert "no such folder" in fault(capsys, "blind", patch, "--data", tmp_path / "no", "--out", out)
    assert "is no fitted patch" in fault(capsys, "scores", patch, *blind[:-2], "--exemplars", made / "made.npz")
    assert "--images: must be at least 4" in fault(capsys, "scores", patch, *blind[:-2], "--images", 3)
    assert "no such file" in fault(capsys, "marks", tmp_path, patch)
    (tmp_path / "answers.json").write_text('{"answer": "rm"}')
    (tmp_path / "marks.txt").write_text("rmr")
    assert "has 3 marks; the sheet has 2 pictures" in fault(capsys, "marks", tmp_path, tmp_path / "marks.txt")
    (tmp_path / "marks.txt").write_text("yes")
    assert "has 'e'; marks are r (real) and m (made)" in fault(capsys, "marks", tmp_path, tmp_path / "marks.txt")
    assert "give a file of marks" in fault(capsys, "marks", tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["answers.json", "marks.txt"]
