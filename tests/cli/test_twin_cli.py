"""`mesoshell distill`, and when `render` takes what was distilled in the place of the shell."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from mesoshell.cli.commands.distill import source_of
from mesoshell.cli.main import main
from mesoshell.cli.options.distill import Options
from mesoshell.datasets.queries.render import check_curvature
from mesoshell.distill.source import ShellSource, from_afar
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.image import read_exr
from mesoshell.io.query_dataset import COLUMNS, read_patches
from mesoshell.io.surface import read_surface, write_surface
from mesoshell.io.twin import Twin
from tests.helpers import wearing

pytestmark = pytest.mark.xdist_group("twin_cli")

BASE = (0.09, 0.06, 0.035)
NEAR, FAR = ("0.5", "0.5", "0.35", "0.5", "0.5", "0", "50"), ("0.5", "0.5", "40", "0.5", "0.5", "0", "3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_bundle) -> Path:
    """A shell with a twin that is grey everywhere, without, and a square that is subdivided."""
    made = tmp_path_factory.mktemp("twin")
    surface = wearing.constant(1.0, 0.2, depth=0.5, curvature=(-1.0, 1.0))
    errors = ((0.002, 0.4), (0.05, 0.01))
    write_bundle(made / "plain.npz", replace(tiny_bundle, thickness=0.5))
    write_bundle(made / "flat.npz", replace(tiny_bundle, thickness=0.25))
    write_bundle(made / "cube.npz", tiny_bundle)
    write_bundle(made / "both.npz", replace(tiny_bundle, thickness=0.5, twin=Twin(surface, (0.25,), BASE, errors)))
    wearing.write_obj(made / "square.obj", wearing.square())
    wearing.write_obj(made / "lump.obj", wearing.lump())
    Image.fromarray(np.full((2, 2), 64, np.uint8)).save(made / "grey.png")
    return made


def shown(folder: Path, camera: tuple[str, ...], *more: str, mesh: str = "square.obj") -> tuple[np.ndarray, dict]:
    out = folder / "out" / "a.png"
    given = ("--thickness", "0.1", "--scale", "0.2", "--light", "0", "0", "1", "--irradiance", "2", "--up", "y")
    size = ("--size", "12", "12", "--camera", *camera)
    main(
        ["render", str(folder / mesh), "--material", str(folder / "both.npz"), "--out", str(out), *given, *size, *more]
    )
    return read_exr(out.with_suffix(".exr")), json.loads(out.with_suffix(".json").read_text())


def test_from_afar_it_stands_in_and_from_nearby_it_does_not(folder, capsys) -> None:
    image, record = shown(folder, FAR, "--explain")
    said = capsys.readouterr().err
    assert record["effects"]["twin"]["on"] and "on  twin: footprints begin at" in said
    assert record["queries"] == record["counts"]["queries"] > 0 and "density_queries" not in record["counts"]
    np.testing.assert_allclose(image[6, 6], [0.4, 0.4, 0.4, 1], rtol=1e-3)
    image, record = shown(folder, NEAR, "--explain")
    assert not record["effects"]["twin"]["on"] and "off twin: footprints begin at" in capsys.readouterr().err
    assert record["counts"]["density_queries"] > 0 and np.ptp(image[4:8, 4:8, :3]) > 1e-3


def test_and_in_the_path_tracer(folder, capsys) -> None:
    """By the same decision: a surface material is asked, with the same colour, and no shell is marched."""
    traced = ("--engine", "mitsuba", "--spp", "16", "--max-depth", "2", "--explain")
    image, record = shown(folder, FAR, *traced)
    said = capsys.readouterr().err
    assert "on  twin: footprints begin at" in said and "off shells: no shells" in said
    assert record["effects"]["twin"]["on"] and record["effects"]["surface_materials"]["on"]
    np.testing.assert_allclose(image[6, 6], [0.4, 0.4, 0.4, 1], rtol=1e-3)
    image, record = shown(folder, NEAR, *traced)
    assert not record["effects"]["twin"]["on"] and record["effects"]["shells"]["on"]
    assert not record["effects"]["surface_materials"]["on"] and np.ptp(image[4:8, 4:8, :3]) > 1e-3


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (("--quality", "reference", "--set", "samples=8", "--set", "pixel_samples=1"), "switched off by quality"),
        (("--param", "dryness=2"), "it has other parameters"),
        (("--param", "dryness={folder}/grey.png"), "dryness varies"),
        (("--base", "0.5", "0.5", "0.5"), "the surface under it has another colour"),
        (("--thickness", "0.05"), "it is 0.25 to 0.25 of a patch thick, and not 0.5"),
    ],
)
def test_it_is_not_another_shells(folder, more: tuple[str, ...], why: str) -> None:
    _, record = shown(folder, FAR, *(x.format(folder=folder) for x in more))
    assert not record["effects"]["twin"]["on"] and why in record["effects"]["twin"]["why"]


def test_nor_one_that_bends_more_than_was_learned(folder) -> None:
    camera = ("0.5", "0.5", "400", "0.5", "0.5", "0", "0.4")
    _, record = shown(folder, camera, "--thickness", "0.001", "--scale", "0.002", mesh="lump.obj")
    assert record["effects"]["twin"]["on"], record["effects"]["twin"]["why"]
    _, record = shown(folder, camera, "--thickness", "0.08", "--scale", "0.16", mesh="lump.obj")
    assert not record["effects"]["twin"]["on"]


FEW = ["--preset", "tiny", "--patches", "2", "--queries", "256", "--kimg", "4.096", "--param", "dryness=1"]


def test_distill_makes_both_files(folder, capsys, monkeypatch) -> None:
    """The twin is of wide footprints alone, with a bound for each octave of these."""
    monkeypatch.setattr("mesoshell.distill.error.PICTURES", 2)
    monkeypatch.setattr("mesoshell.distill.error.RAYS", 1)
    out, both = folder / "d" / "surface.npz", folder / "d" / "twin.npz"
    main(["distill", str(folder / "plain.npz"), "--out", str(out), "--twin", str(both), *FEW])
    said = capsys.readouterr().out.splitlines()
    assert str(out) in said and said[-1] == str(both)
    surface, bundle = read_surface(out), read_bundle(both)
    assert surface.depth == 0.5 and surface.curvature == (-1.0, 1.5) and surface.texels == 32
    assert bundle.twin is not None and bundle.twin.surface.texels == 4
    assert bundle.twin.surface.curvature == (-0.5, 0.5)
    assert bundle.twin.alpha == (0.5,) and bundle.twin.base == BASE
    radii, errors = np.array(bundle.twin.errors).T
    np.testing.assert_array_equal(radii, [0.25, 0.5, 1, 2])
    assert np.isfinite(errors).all() and (errors > 0).all()
    asked = [read_patches(folder / "d" / "surface" / run / "queries") for run in ("", "afar")]
    assert [d.manifest["narrowest"] for d in asked] == [1 / 512, 0.25]
    for data, (low, high) in zip(asked, ((1 / 512, 0.01), (0.25, 0.27)), strict=True):
        least = min(rows[:, COLUMNS.index("radius")].min() for rows in data.patches)
        assert low <= least * (1 + 1e-6) and least < high


@pytest.mark.slow
def test_of_corner_tiles_there_is_a_twin_and_nothing_else(tmp_path, tiled_bundle, capsys, monkeypatch) -> None:
    monkeypatch.setattr("mesoshell.distill.error.PICTURES", 2)
    monkeypatch.setattr("mesoshell.distill.error.RAYS", 1)
    tiles, surface, both = (tmp_path / name for name in ("tiles.npz", "surface.npz", "both.npz"))
    write_bundle(tiles, replace(tiled_bundle, thickness=0.5))
    wearing.write_obj(tmp_path / "square.obj", wearing.square())
    with pytest.raises(SystemExit, match="2"):
        main(["distill", str(tiles), "--out", str(surface), *FEW])
    line = capsys.readouterr().err
    assert line.startswith("mesoshell: --out: ") and "has corner tiles" in line and line.count("\n") == 1
    assert not surface.exists() and not surface.with_suffix("").exists()
    main(["distill", str(tiles), "--twin", str(both), *FEW])
    bundle = read_bundle(both)
    assert bundle.tiles == tiled_bundle.tiles and bundle.twin is not None
    good = replace(bundle, twin=replace(bundle.twin, errors=((0.002, 0.4), (0.05, 0.01)), alpha=(0.25,)))
    write_bundle(both, good)
    for camera, taken in ((FAR, True), (NEAR, False)):
        _, record = shown(tmp_path, camera)
        assert record["effects"]["twin"]["on"] == taken, record["effects"]["twin"]["why"]


@pytest.mark.slow
def test_a_twin_alone_is_the_same(folder, monkeypatch) -> None:
    monkeypatch.setattr("mesoshell.distill.error.PICTURES", 2)
    monkeypatch.setattr("mesoshell.distill.error.RAYS", 1)
    given = ["distill", str(folder / "plain.npz"), "--twin"]
    main([*given, str(folder / "e" / "twin.npz"), "--out", str(folder / "e" / "surface.npz"), *FEW])
    main([*given, str(folder / "f" / "alone.npz"), *FEW])
    both, alone = (read_bundle(folder / name).twin for name in ("e/twin.npz", "f/alone.npz"))
    assert both is not None and alone is not None and alone.errors == both.errors
    for key, array in alone.surface.arrays.items():
        np.testing.assert_array_equal(both.surface.arrays[key], array)


@pytest.mark.parametrize("name", [pytest.param("spheres", marks=pytest.mark.slow), "heights.png"])
def test_geometry_is_distilled_too(folder, name: str) -> None:
    """By its name or as an image of heights; what only a shell has is refused."""
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(folder / "heights.png")
    few = ["--preset", "tiny", "--patches", "2", "--queries", "256", "--spp", "1", "--kimg", "2.048"]
    source, depth = (name, 0.2) if name == "spheres" else (str(folder / name), 0.12)
    out = folder / "geometry" / f"{name}.npz"
    main(["distill", source, "--out", str(out), *few])
    surface = read_surface(out)
    assert surface.depth == depth and surface.curvature == (-1.0, 2.0)
    assert surface.provenance["dataset"]["source"] == source


def test_a_run_belongs_to_what_it_was_begun_with(folder, capsys) -> None:
    """The shell's bytes, and how many cylinders; and a manifest that is none is said to be."""
    few = ["--preset", "tiny", "--queries", "16", "--kimg", "2.048", "--out", str(folder / "begun" / "a.npz")]
    shell = folder / "begun.npz"
    shell.write_bytes((folder / "plain.npz").read_bytes())
    main(["distill", str(shell), *few, "--patches", "2"])
    queries = folder / "begun" / "a" / "queries"
    manifest, text = queries / "manifest.json", (queries / "manifest.json").read_text()
    for patches, material, written, said in (
        ("3", "plain.npz", text, f"--patches: {queries} was begun with 2, not 3"),
        ("2", "both.npz", text, f"{manifest}: has source "),
        ("2", "plain.npz", "{", f"{manifest}: not JSON: Expecting property name"),
    ):
        shell.write_bytes((folder / material).read_bytes())
        manifest.write_text(written)
        capsys.readouterr()
        with pytest.raises(SystemExit) as caught:
            main(["distill", str(shell), *few, "--patches", patches])
        line = capsys.readouterr().err
        assert caught.value.code == 2 and line.startswith(f"mesoshell: {said}") and line.count("\n") == 1, line


@pytest.mark.parametrize(
    ("name", "depth", "curvature", "afar"),
    [("flat", 0.25, (-2.0, 3.0), 0.5), ("plain", 0.5, (-1.0, 1.5), 0.5), ("cube", 1.0, (-0.5, 0.75), 0.5)],
)
def test_a_shell_is_learned_as_high_as_it_was_made(folder, name: str, depth: float, curvature, afar: float) -> None:
    """And under surfaces that it fits under."""
    shell = source_of(Options(str(folder / f"{name}.npz"), folder / "x.npz"))
    assert isinstance(shell, ShellSource)
    assert (shell.settings.depth, shell.settings.curvature) == (depth, curvature)
    assert from_afar(shell, None).settings.curvature == (-0.5, afar)
    check_curvature(shell.settings.curvature, shell.settings.depth)
    tall = source_of(Options(str(folder / f"{name}.npz"), folder / "x.npz", thickness=3.0))
    assert isinstance(tall, ShellSource) and from_afar(tall, None).settings.curvature == (-0.5, 0.25)


@pytest.mark.parametrize("preset, widths", [("small", (64, 64, 64)), ("mini", (64, 64, 64)), ("tiny", (16, 16))])
def test_a_shell_is_given_wider_networks_than_geometry(folder, preset: Any, widths: tuple[int, ...]) -> None:
    shell = source_of(Options(str(folder / "plain.npz"), folder / "x.npz", preset=preset))
    weave = source_of(Options("weave", folder / "x.npz", preset=preset))
    assert shell.config.surface.hidden == widths and (shell.patches, shell.settings.queries) == (4096, 2048)
    assert weave.config.surface.hidden == (widths if preset == "tiny" else (24, 24, 24))
    assert (weave.patches, weave.settings.queries, weave.settings.widest) == (1024, 8192, 0.25)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("spheres", "--base", "0", "0", "0"), "--base: requires a shell; spheres is not one"),
        (("spheres", "--twin", "{folder}/t.npz"), "--twin: requires a shell; spheres is not one"),
        (("spheres", "--param", "age=1"), "--param: requires a shell; spheres is not one"),
        (("spheres", "--thickness", "2"), "--thickness: of geometry is at most 1, not 2"),
        (("spheres", "--thickness", "0.6"), "--curvature: "),
        (
            ("nothing",),
            "nothing: neither a material, nor an image of heights, nor one of carpet, fur, grass, lawn, pelt, turf, weave, ",
        ),
        (("{folder}/square.obj",), "{folder}/square.obj: "),
        (("{folder}",), "{folder}: no such material"),
        (("{folder}/surface.npz",), "{folder}/surface.npz: is a surface material already"),
    ],
)
def test_what_cannot_be_learned_from_is_one_line(folder, capsys, given: tuple[str, ...], said: str) -> None:
    write_surface(folder / "surface.npz", wearing.constant(1.0, 0.2, depth=0.5, curvature=(-1.0, 1.0)))
    out = folder / "none.npz"
    with pytest.raises(SystemExit) as caught:
        main(["distill", *(x.format(folder=folder) for x in given), "--out", str(out)])
    line = capsys.readouterr().err
    assert caught.value.code == 2 and line.startswith(f"mesoshell: {said.format(folder=folder)}"), line
    assert line.count("\n") == 1 and not out.exists() and not out.with_suffix("").exists()


def test_something_must_be_asked_for(folder, capsys) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["distill", str(folder / "plain.npz")])
    assert caught.value.code == 2
    assert capsys.readouterr().err == "mesoshell: --out: give it, or --twin, or both\n"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--spp", "4"), "--spp: requires geometry; {folder}/plain.npz is a shell, which is marched"),
        (("--patches", "1"), "--patches: must be at least 2, not 1"),
        (("--queries", "100"), "--queries: 100 on a cylinder: a step takes 256"),
        (("--kimg", "0"), "--kimg: must be above 0, not 0"),
        (("--out", "{folder}/none"), "{folder}/none: must end in .npz"),
        (("--twin", "{folder}/none.txt"), "{folder}/none.txt: must end in .npz"),
        (("--thickness", "0"), "--thickness: must be above 0 and below 10, not 0"),
        (("--base", "-1", "0", "0"), "--base: must be from 0 to 1: the share of light that it reflects"),
        (
            ("--param", "dryness={folder}/grey.png"),
            "--param: dryness is an image: a surface material is the same everywhere",
        ),
        (("--param", "wetness=1"), "--param: "),
        (("--twin", "{folder}/none.npz"), "--twin: {folder}/none.npz is the same file as --out"),
    ],
)
def test_what_cannot_be_distilled_is_one_line(folder, capsys, more: tuple[str, ...], said: str) -> None:
    out = folder / "none.npz"
    with pytest.raises(SystemExit) as caught:
        main(["distill", str(folder / "plain.npz"), "--out", str(out), *(x.format(folder=folder) for x in more)])
    line = capsys.readouterr().err
    assert (
        caught.value.code == 2 and line.startswith(f"mesoshell: {said.format(folder=folder)}") and line.count("\n") == 1
    )
    assert not out.exists() and not out.with_suffix("").exists()
