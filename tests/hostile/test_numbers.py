"""Numbers and paths on the command line that cannot be used end in one line and status 2, before any work."""

from pathlib import Path

import pytest

from mesoshell.cli.main import main

REFUSED = [
    ["--size", "100000", "100000"],
    ["--size", "1000000000000", "1"],
    ["--size", "0", "4"],
    ["--size", "-1", "4"],
    ["--size", "1e3", "4"],
    ["--spp", "99999999999", "--engine", "mitsuba"],
    ["--spp", "0", "--engine", "mitsuba"],
    ["--max-depth", "-3", "--engine", "mitsuba"],
    ["--spp", "4"],
    ["--seed", str(2**64)],
    ["--seed", str(-(2**70))],
    ["--scale", "1e-30"],
    ["--scale", "0"],
    ["--scale", "nan"],
    ["--scale", "inf"],
    ["--thickness", "-1"],
    ["--thickness", "nan"],
    ["--light", "0", "0", "0"],
    ["--light", "nan", "0", "0"],
    ["--irradiance", "-1"],
    ["--irradiance", "inf"],
    ["--base", "nan", "0", "0"],
    ["--camera", "0", "0", "0", "0", "0", "0", "40"],
    ["--camera", "0", "0", "9", "0", "0", "0", "180"],
    ["--camera", "0", "0", "inf", "0", "0", "0", "40"],
    ["--param", "age"],
    ["--param", "age=nan"],
    ["--param", "age=9e99"],
    ["--param", "none=1"],
    ["--material", "none"],
    ["--material", "/dev/null"],
    ["--environment", "none.exr"],
    ["--object", "none.obj"],
    ["--out", "/dev/null/x.png"],
    ["--out", "folder.png"],
    ["--out", "folder/"],
    ["--out", "folder"],
    ["--out", "new/"],
    ["--out", ""],
    ["--out", "n" * 5000],
]


@pytest.mark.parametrize("given", REFUSED, ids=lambda given: " ".join(given)[:40])
def test_a_render_of_what_cannot_be_is_refused(given: list[str], good: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "folder").mkdir()
    rest = [] if "--out" in given else ["--out", "a.png"]
    with pytest.raises(SystemExit) as end:
        main(["render", str(good / "ball.obj"), *rest, *given])
    lines = [x for x in capsys.readouterr().err.splitlines() if not x.startswith("note: ")]
    assert end.value.code == 2 and len(lines) == 1 and lines[0].startswith("mesoshell: ")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["folder", "folder.png"]


EXPERIMENTS = {
    "exits": "import sys\nsys.exit()",
    "exits with 3": "raise SystemExit(3)",
    "raises": "raise RuntimeError('a\\nb')",
    "is none": "x = 1",
    "is torn": "def f(:",
    "is binary": "\x01\x02",
    "recurses": "def f(): f()\nf()",
    "has text": "config = 'text'",
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_that_is_none_is_refused(name: str, tmp_path: Path, capsys):
    path = tmp_path / "x.py"
    path.write_text(EXPERIMENTS[name])
    with pytest.raises(SystemExit) as end:
        main(["train", str(path), "--data", str(tmp_path), "--run", str(tmp_path / "run")])
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.count("\n") == 1 and "x.py" in said
    assert not (tmp_path / "run").exists()


COUNTED = """
from pathlib import Path
from mesoshell.train.gan.presets import PRESETS
with (Path(__file__).parent / "times").open("a") as file:
    file.write("x")
config = PRESETS["tiny"]
"""


def test_an_experiment_is_executed_once(tmp_path: Path, capsys):
    (tmp_path / "x.py").write_text(COUNTED)
    with pytest.raises(SystemExit):
        main(["train", str(tmp_path / "x.py"), "--data", str(tmp_path / "none"), "--run", str(tmp_path / "run")])
    assert capsys.readouterr().err == f"mesoshell: {tmp_path}/none: no such folder\n"
    assert (tmp_path / "times").read_text() == "x"
