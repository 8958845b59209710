"""`mesoshell dataset` as a user calls it: what it says, and one line for each fault."""

from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.main import main
from mesoshell.datasets.blender import process as blender
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.image import read_png

ROOT = Path(__file__).parents[2]
needs_blender = pytest.mark.skipif(
    not (ROOT / "data_gen/.venv/installed").exists(), reason="no Blender environment (Python 3.11): make blender"
)


def said(capsys, *arguments: object) -> tuple[int, str, str]:
    """Exit status, standard output, standard error."""
    try:
        main(["dataset", *map(str, arguments)])
        status = 0
    except SystemExit as end:
        status = int(end.code or 0)
    out, err = capsys.readouterr()
    return status, out, err


@needs_blender
def test_from_blender_to_arrays(tmp_path, capsys):
    whole, packed, sheet = tmp_path / "grass", tmp_path / "grass8", tmp_path / "sheet.png"
    render = ("render", "grass", "--count", 3, "--size", 16, "--spp", 2, "--out", whole)
    status, out, _ = said(capsys, *render)
    assert status == 0 and out.startswith(f"{whole}: 0 samples were there, 3 are new\n")
    assert "images a minute; seconds a sample: geometry 0." in out and "bytes a sample; at most " in out
    assert said(capsys, *render)[1] == f"{whole}: 3 samples were there, 0 are new\n"
    assert said(capsys, "check", whole) == (0, f"{whole}: no faults\n", "")
    assert (
        said(capsys, "pack", whole, "--size", 8, "--out", packed)[1] == f"{packed}: 3 samples, 0.0 MB, 512 bytes each\n"
    )
    assert check_dataset(packed) == []
    assert said(capsys, "sheet", packed, "--sort", "age", "--out", sheet) == (0, f"{sheet}\n", "")
    (whole / "images/000001.exr").unlink()
    (whole / "images/000002.exr").write_bytes(b"")
    status, out, _ = said(capsys, "check", whole)
    assert status == 1 and out.endswith(f"{whole}: 3 faults\n") and "000001.exr: no such file" in out
    before = (whole / "manifest.json").read_bytes()
    status, out, err = said(capsys, "render", "fur", "--count", 3, "--size", 16, "--out", whole)
    assert (status, out) == (2, "") and err == f"mesoshell: {whole}/manifest.json: has recipe grass, asked for fur\n"
    assert (whole / "manifest.json").read_bytes() == before


@needs_blender
def test_many_patches_are_continued_and_are_the_same_bytes_by_any_workers(tmp_path, capsys):
    one, two = tmp_path / "one", tmp_path / "two"
    render = ("render", "grass", "--views", 2, "--size", 16, "--spp", 1)
    assert said(capsys, *render, "--patches", 1, "--workers", 1, "--out", one)[0] == 0
    _, out, _ = said(capsys, *render, "--patches", 2, "--workers", 1, "--out", one)
    assert out.startswith(f"{one}: 2 samples were there, 2 are new\n")
    assert said(capsys, *render, "--patches", 2, "--workers", 2, "--out", two)[0] == 0
    names = sorted(p.relative_to(one) for p in one.rglob("*") if p.is_file() and p.name != "log.jsonl")
    assert len(names) == 6 and all((one / n).read_bytes() == (two / n).read_bytes() for n in names)
    rows = read_dataset(one).rows
    assert [rows[i]["instance"] for i in range(4)] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ((), "--count: give it, or both --patches and --views"),
        (("--patches", 2), "--patches: requires --views"),
        (("--tiles",), "--count: give it, or both --patches and --views"),
        (("--tiles", "--count", 16, "--patch", 0), "--tiles: cannot be combined with --patch"),
        (("--tiles", "--patches", 2, "--views", 2), "--tiles: cannot be combined with --patches and --views"),
        (("--views", 2), "--views: requires --patches"),
        (
            ("--count", 4, "--scheduler", "tcp://127.0.0.1:1", "--workers", 2),
            "--workers: cannot be combined with --scheduler, whose workers they are",
        ),
        (("--patches", 2, "--views", 2, "--count", 4), "--count: cannot be combined with --patches and --views"),
        (("--patches", 2, "--views", 2, "--patch", 0), "--patch: cannot be combined with --patches and --views"),
        (("--patches", 0, "--views", 2), "--patches: must be at least 1, not 0"),
    ],
)
def test_how_many_images_is_said_in_one_way(given, fault, tmp_path, capsys):
    found = said(capsys, "render", "grass", *given, "--out", tmp_path / "data")
    assert found == (2, "", f"mesoshell: {fault}\n") and not (tmp_path / "data").exists()


@needs_blender
def test_a_sheet_of_each_parameter_alone(tmp_path, capsys):
    out = tmp_path / "parameters.png"
    status, text, _ = said(capsys, "vary", "grass", "--steps", 3, "--size", 24, "--spp", 4, "--out", out)
    assert (status, text) == (0, f"{out}: rows are age; columns from least to greatest\n")
    fresh, _, straw = np.split(read_png(out)[2:-2, :78, :3], 3, axis=1)
    assert straw[..., 0].mean() > 1.2 * fresh[..., 0].mean(), "straw is redder"


@needs_blender
def test_what_accuracy_costs(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mesoshell.datasets.blender.cost.REFERENCE", 64)
    monkeypatch.setattr("mesoshell.cli.commands.dataset_blender.SPP", (1, 16))
    status, text, _ = said(capsys, "cost", "grass", "--size", 24)
    assert status == 0
    rows = [line.split() for line in text.splitlines() if line.strip().startswith(("1 ", "16 "))]
    assert float(rows[1][1]) > float(rows[0][1]) + 6, "16 times the paths, up to 12 dB"


@pytest.fixture(params=[True, False], ids=["with Blender", "without"])
def _with_or_without(request, monkeypatch) -> None:
    if not request.param:
        monkeypatch.setattr(blender, "_ENVIRONMENT", Path("nowhere"))
    elif not (ROOT / "data_gen/.venv/installed").exists():
        pytest.skip("no Blender environment (Python 3.11): make blender")


@pytest.mark.usefixtures("_with_or_without")
@pytest.mark.parametrize(
    ("more", "fault"),
    [
        (["--count", 0], "--count: must be at least 1, not 0"),
        (["--count", 1, "--size", 0], "--size: must be at least 1, not 0"),
        (["--count", 1, "--workers", 0], "--workers: must be at least 1, not 0"),
        (["--count", 1, "--param", "age=2"], "dataset: parameter age must lie in 0 to 1, not 2"),
        (["--count", 1, "--param", "hue=1"], "dataset: grass has no parameter hue; it has age"),
        (["--count", 1, "--param", "age"], "--param: age is not NAME=NUMBER"),
        (["--count", 1, "--coverage", 1, 9], "dataset: coverage must rise within 0.001 to 2.5: 1.0 9.0"),
    ],
)
def test_unusable_options_leave_no_folder(more, fault: str, tmp_path, capsys):
    status, out, err = said(capsys, "render", "grass", "--out", tmp_path / "d", *more)
    assert (status, out, err) == (2, "", f"mesoshell: {fault}\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("_with_or_without")
def test_an_unknown_recipe_lists_those_there_are(tmp_path, capsys):
    _, _, err = said(capsys, "render", "moss", "--count", 1, "--out", tmp_path / "d")
    assert err == (
        "mesoshell: dataset: no recipe named moss; there are: carpet, carpet2, carpet4, carpet6, carpet8, fur, grass\n"
    )


@pytest.mark.parametrize("verb", ["vary", "cost"])
def test_a_parameter_is_checked_before_blender_is_looked_for(verb, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(blender, "_ENVIRONMENT", Path("nowhere"))
    found = said(capsys, verb, "grass", "--param", "age=2", "--out", tmp_path / "d")
    assert found == (2, "", "mesoshell: dataset: parameter age must lie in 0 to 1, not 2\n")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_blender_environment_names_the_command_that_makes_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(blender, "_ENVIRONMENT", Path("nowhere"))
    status, _, err = said(capsys, "render", "grass", "--count", 1, "--out", tmp_path / "d")
    assert (status, err) == (2, "mesoshell: nowhere: no Blender environment; make it with: make blender\n")
    assert list(tmp_path.iterdir()) == []
