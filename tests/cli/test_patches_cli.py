"""`mesoshell dataset render-patches` as a user calls it: what it says, and one line for each fault."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mesoshell import limits
from mesoshell.cli.main import main
from mesoshell.io.query_dataset import read_patches

TINY = ("--patches", 2, "--queries", 256, "--spp", 2)


def said(capsys, *arguments: object) -> tuple[int, str, str]:
    """Exit status, standard output, standard error."""
    try:
        main(["dataset", "render-patches", *map(str, arguments)])
        status = 0
    except SystemExit as end:
        status = int(end.code or 0)
    out, err = capsys.readouterr()
    return status, out, err


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "waves.png"
    waves = 0.5 + 0.5 * np.sin(2 * np.pi * np.arange(8) / 8)
    Image.fromarray(np.round(255 * np.tile(waves, (4, 1))).astype(np.uint8)).save(path)
    return path


def test_from_a_name_to_queries(tmp_path: Path, capsys):
    out = tmp_path / "weave"
    status, text, err = said(capsys, "weave", "--out", out, *TINY)
    first, second = text.splitlines()
    assert (status, err) == (0, "") and first == f"{out}: 0 patches were there, 2 are new"
    number = r"\d+\.\d\d"
    said_of_time = f"{number} million queries a minute; seconds a patch: geometry {number}, light {number}"
    assert re.fullmatch(said_of_time, second)
    made = read_patches(out)
    assert [patch.shape for patch in made.patches] == [(256, 16)] * 2
    assert (made.manifest["source"], made.manifest["depth"], made.manifest["curvature"]) == ("weave", 0.12, [-1, 2])
    assert said(capsys, "weave", "--out", out, *TINY) == (0, f"{out}: 2 patches were there, 0 are new\n", "")


def test_it_goes_on_from_an_image_and_refuses_another_seed(image: Path, tmp_path: Path, capsys):
    out = tmp_path / "waves"
    common = (image, "--out", out, "--queries", 16, "--spp", 1, "--depth", 0.2, "--curvature", -0.5, 0.5)
    assert said(capsys, *common, "--patches", 1)[1].startswith(f"{out}: 0 patches were there, 1 are new\n")
    assert said(capsys, *common, "--patches", 3)[1].startswith(f"{out}: 1 patches were there, 2 are new\n")
    assert said(capsys, *common, "--patches", 2)[1] == f"{out}: 2 patches were there, 0 are new\n"
    made = read_patches(out)
    assert len(made.patches) == 3 and made.manifest["depth"] == 0.2 and made.manifest["count"] == 3
    assert all(np.abs(patch[:, 6]).max() <= 0.5 for patch in made.patches)
    fault = f"mesoshell: {out}/manifest.json: has seed 0, asked for 1\n"
    assert said(capsys, *common, "--patches", 4, "--seed", 1) == (2, "", fault)


def test_the_depth_is_the_images_own_if_nothing_is_said(image: Path, tmp_path: Path, capsys):
    assert said(capsys, image, "--out", tmp_path / "d", "--patches", 1, "--queries", 1, "--spp", 1)[0] == 0
    assert read_patches(tmp_path / "d").manifest["depth"] == 0.12


@pytest.mark.parametrize(
    ("more", "fault"),
    [
        (["--patches", 0], "--patches: must be at least 1, not 0"),
        (["--queries", 0], "--queries: must be at least 1, not 0"),
        (["--spp", -1], "--spp: must be at least 1, not -1"),
        (["--seed", -1], "--seed: must be at least 0, not -1"),
        (["--queries", 2**20, "--spp", 2**12], "--spp: times --queries must be below 2^32, not 4294967296"),
        (["--depth", 0], "--depth: must be above 0 and at most 1, not 0.0"),
        (["--depth", "nan"], "--depth: must be above 0 and at most 1, not nan"),
        (["--depth", 1.5], "--depth: must be above 0 and at most 1, not 1.5"),
        (["--curvature", 1, -1], "--curvature: 1 to -1 is no range"),
        (["--curvature", "nan", 1], "--curvature: nan to 1 is no range"),
        (["--curvature", 0, "inf"], "--curvature: 0 to inf is no range"),
        (
            ["--curvature", -1, 8],
            "--curvature: a layer 0.12 deep does not fit under a surface of radius 0.125: at most 7.91667",
        ),
        (["--depth", 0.5], "--curvature: a layer 0.5 deep does not fit under a surface of radius 0.5: at most 1.9"),
    ],
)
def test_unusable_options_leave_no_folder(more, fault: str, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr(limits, "memory", lambda: 2**41)
    assert said(capsys, "weave", "--out", tmp_path / "d", *more) == (2, "", f"mesoshell: {fault}\n")
    assert list(tmp_path.iterdir()) == []


def test_more_light_paths_than_memory_holds_are_refused(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr(limits, "memory", lambda: 2**30)
    fault = "--spp: 256 light paths for each of 65536 queries would take 5.0 GiB; this machine has 1.0"
    assert said(capsys, "weave", "--out", tmp_path / "d", "--spp", 256) == (2, "", f"mesoshell: {fault}\n")


def test_unusable_sources_leave_no_folder(image: Path, tmp_path: Path, capsys):
    (tmp_path / "a.txt").write_text("weave")
    Image.fromarray(np.full((4, 4), 7, np.uint8)).save(tmp_path / "flat.png")
    before = sorted(tmp_path.iterdir())
    for name, fault in (
        ("moss", "neither an image file nor one of weave, scales, spheres, fibres"),
        (tmp_path / "none.png", "neither an image file nor one of weave, scales, spheres, fibres"),
        (tmp_path / "a.txt", "not an image file, or a corrupt one"),
        (tmp_path / "flat.png", "has no heights: one value everywhere, or one that is not finite"),
    ):
        assert said(capsys, name, "--out", tmp_path / "d", *TINY) == (2, "", f"mesoshell: {name}: {fault}\n")
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_that_cannot_be_made(image: Path, capsys):
    before = image.read_bytes()
    fault = f"mesoshell: {image}: cannot be made: File exists\n"
    assert said(capsys, image, "--out", image, *TINY) == (2, "", fault) and image.read_bytes() == before


def test_help_says_units_and_defaults(capsys):
    status, out, _ = said(capsys, "--help")
    assert status == 0
    text = " ".join(out.replace("│", " ").split())
    for words in (
        "weave, scales, spheres or fibres",
        "1 / period",
        "default: 2400",
        "default: 65536",
        "default: -1.0 2.0",
    ):
        assert words in text, words
