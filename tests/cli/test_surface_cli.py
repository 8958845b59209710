"""From traced queries to a picture of a surface material, by the commands a user calls; and one line for each fault."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.main import main
from mesoshell.io.image import read_exr, read_png
from mesoshell.io.surface import read_surface, write_surface
from mesoshell.measure.queries import QUERIES
from tests.helpers import wearing

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("surface_cli")

EXPERIMENT = Path(__file__).parents[2] / "experiments" / "weave_silhouette.py"
ENGINES = ("jax", "mitsuba")
#: `main` where nothing can import JAX.
WITHOUT_JAX = (
    "import sys; sys.modules.update(dict.fromkeys(('jax', 'jaxlib', 'flax', 'optax')))\n"
    "from mesoshell.cli.main import main; main(sys.argv[1:])"
)


def answer(q: dict[str, np.ndarray]) -> dict:
    alpha = np.clip(0.5 + q["w"][:, 2], 0, 1)
    return {"alpha": alpha, "cosine": 0, "rgb": 0.1 * alpha[:, None]}


@pytest.fixture(scope="module", autouse=True)
def _no_cache_at_home(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Queries, a random material, one of constant answers, and meshes."""
    made = tmp_path_factory.mktemp("made")
    wearing.write_patches(made / "patches", [wearing.rows(128, k, answer) for k in range(5)])
    write_surface(made / "rough.npz", wearing.bundle(provenance={"dataset": {"source": "weave"}}))
    write_surface(made / "narrow.npz", wearing.constant(1.0, 0.2, curvature=(-1e-3, 1e-3)))
    wearing.write_obj(made / "lump.obj", wearing.lump())
    return made


@pytest.fixture(scope="module")
def run(folder) -> Path:
    """A few steps."""
    given = [
        "train",
        EXPERIMENT,
        "--preset",
        "tiny",
        "--data",
        folder / "patches",
        "--run",
        folder / "run",
        "--kimg",
        8.192,
    ]
    main([*map(str, given)])
    return folder / "run"


def rendered(folder: Path, out: Path, *more: object, material: object = "rough.npz") -> None:
    given = ["render", folder / "lump.obj", "--material", folder / str(material), "--size", 20, 16, "--out", out, *more]
    main([str(x) for x in given])


def fault(capsys, *arguments: object) -> str:
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and said.startswith("mesoshell: "), said
    return said


def test_a_run_leaves_materials(run) -> None:
    """Of which the last is that of its end, with what it was made of."""
    (path,) = (run / "snapshots").iterdir()
    found = read_surface(path)
    assert path.stem == "000008192" and found.texels == 32 and found.curvature == (-1.0, 2.0) and found.depth == 0.125
    assert found.provenance["queries"] == 8192 and found.provenance["config"]["batch"] == 1024
    assert read_png(run / "sheets" / "000008192.png")[..., :3].std() > 0.01
    rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert rows[-1]["kimg"] == 8.192 and rows[-1]["reflectance"] > 0 and rows[-1]["opacity"] > 0


def test_it_is_scored_once(run, capsys) -> None:
    main(["evaluate", str(run)])
    said = capsys.readouterr().out
    rows = [json.loads(line) for line in (run / "evaluation.jsonl").read_text().splitlines()]
    assert [row["name"] for row in rows] == sorted(QUERIES)
    assert {(row["kimg"], row["images"]) for row in rows} == {(8.192, 1)}
    for name in QUERIES:
        assert f"8.192 kimg: {name} " in said
    assert all(np.isfinite([row["value"], row["low"], row["high"]]).all() and row["value"] > 0 for row in rows)
    assert said.splitlines()[-1] == str(run / "report.html") and (run / "report.html").read_text().count(QUERIES[0]) > 0
    main(["evaluate", str(run)])
    assert capsys.readouterr().out.splitlines() == [str(run / "report.html")]
    assert len((run / "evaluation.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize("engine", ENGINES)
def test_a_picture_and_what_it_took(run, folder, tmp_path, capsys, engine: str) -> None:
    """Of the run's own material; effects are printed if they are asked for."""
    (path,) = (run / "snapshots").iterdir()
    out = tmp_path / "new" / "picture.png"
    more = ["--spp", 4] if engine == "mitsuba" else ["--quality", "draft"]
    rendered(folder, out, "--engine", engine, "--explain", *more, material=path)
    said = capsys.readouterr()
    assert said.out == f"{out}\n"
    linear, shown = read_exr(out.with_suffix(".exr")), read_png(out)
    assert linear.shape == shown.shape == (16, 20, 4) and np.isfinite(linear).all() and (linear >= 0).all()
    assert linear[0, 0, 3] == 0 and linear[8, 10, 3] > 0.5 and linear[8, 10, :3].max() > 0.01
    record = json.loads(out.with_suffix(".json").read_text())
    assert {"version", "engine", "seconds", "rays", "queries", "effects", "quality", "material"} <= record.keys()
    assert record["engine"] == engine and record["rays"] >= 20 * 16
    assert record["material"]["dataset"]["source"] == "weave" and record["material"]["name"] == str(path)
    name = "surface_materials" if engine == "mitsuba" else "opacity"
    assert record["effects"][name]["on"] and all(str(e["why"]) for e in record["effects"].values())
    for effect, entry in record["effects"].items():
        line = f"{'on ' if entry['on'] else 'off'} {effect.replace('_', ' ')}: {entry['why']}"
        assert line in said.err
    assert record["seconds"]["total"] > 0 and "total" in said.err
    if engine == "jax":
        assert record["queries"] > 50 and record["counts"]["transport_queries"] == 3 * record["queries"]
    assert sorted(p.name for p in out.parent.iterdir()) == ["picture.exr", "picture.json", "picture.png"]


@pytest.mark.slow  # the path tracer's tests compare answers, lights and skies
def test_the_engines_show_the_same(folder, tmp_path) -> None:
    """A random material by lights of the command line, with an object and its shadow; and by a sky."""
    from mesoshell.io.image import write_exr

    image = np.full((16, 32, 4), 0.05, np.float32)
    image[:6, :, 2] = 2.0
    image[5:9, 3:8, 0] = 20.0
    write_exr(tmp_path / "sky.exr", image)
    plate = wearing.moved(wearing.square(), 0.0, 0.0, 0.9)
    wearing.write_obj(tmp_path / "plate.obj", wearing.joined(plate, wearing.turned(wearing.moved(plate, 0, 0, 0.01))))
    common = ("--up", "z", "--scale", 1.0, "--camera", 3.0, -2.0, 0.6, 0.5, 0.5, 0.2, 40)
    for name, more in (
        ("lights", ("--light", -0.4, -0.6, 0.7, "--light", 1, 0, 0.2, "--object", tmp_path / "plate.obj")),
        ("sky", ("--environment", tmp_path / "sky.exr")),
    ):
        one, two = tmp_path / f"{name}_m.png", tmp_path / f"{name}_j.png"
        rendered(folder, one, *common, *more, "--engine", "mitsuba", "--max-depth", 2, "--spp", 512)
        rendered(folder, two, *common, *more, "--quality", "reference")
        a, b = (read_exr(x.with_suffix(".exr")) for x in (one, two))
        assert a[..., :3].mean() > 0.05
        np.testing.assert_allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=0.04)
        blocks = [x[..., :3].reshape(4, 4, 5, 4, 3).mean(axis=(1, 3)) for x in (a, b)]
        assert np.corrcoef(blocks[0].ravel(), blocks[1].ravel())[0, 1] > 0.99


def test_the_scale_is_a_25th_of_two_diagonals_if_none_is_given(folder, tmp_path) -> None:
    box = np.ptp(wearing.lump().vertices, axis=0)
    names = [tmp_path / f"{k}.png" for k in range(3)]
    for out, more in zip(names, ((), ("--scale", 2 / 25 * np.linalg.norm(box)), ("--scale", 0.5)), strict=True):
        rendered(folder, out, "--quality", "draft", *more)
    default, same, other = (read_exr(x.with_suffix(".exr")) for x in names)
    np.testing.assert_allclose(default, same, atol=2e-3)
    assert np.abs(default - other).max() > 0.05


@pytest.mark.parametrize("engine", ENGINES)
def test_curvature_that_was_not_trained_is_said(folder, tmp_path, capsys, engine: str) -> None:
    rendered(folder, tmp_path / "a.png", "--engine", engine, "--quality", "draft", material="narrow.npz")
    said = capsys.readouterr().err
    (line,) = [x for x in said.splitlines() if "outside the trained" in x]
    assert (
        line.startswith("note: curvature is outside the trained -0.001 to 0.001 per period at ")
        and "a smaller scale" in line
    )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--param", "age=1"), "--param: {material} is a surface material: it has none (see --scale)"),
        (("--seed", 3), "--seed: {material} is a surface material: it has none (see --scale)"),
        (("--seed", 0), "--seed: {material} is a surface material: it has none (see --scale)"),
        (("--thickness", 0.1), "--thickness: {material} is a surface material: it has none (see --scale)"),
        (("--scale", 0), "--scale: must be above 0, not 0"),
        (("--scale", -1), "--scale: must be above 0, not -1"),
        (("--scale", "nan"), "--scale: must be above 0, not nan"),
        (("--base", -1, 0, 0), "--base: must be from 0 to 1: the share of light that it reflects"),
        (("--light", 0, 0, 0), "--light: (0.0, 0.0, 0.0) is no direction"),
    ],
)
def test_what_cannot_be_is_one_line(folder, tmp_path, capsys, engine: str, given: tuple, said: str) -> None:
    """And leaves no picture."""
    out, material = tmp_path / "a.png", folder / "rough.npz"
    common = ("render", folder / "lump.obj", "--material", material, "--engine", engine, "--out", out)
    assert fault(capsys, *common, *given) == f"mesoshell: {said.format(material=material)}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("engine", ENGINES)
def test_a_damaged_material_is_named(folder, tmp_path, capsys, engine: str) -> None:
    path = tmp_path / "cut.npz"
    path.write_bytes((folder / "rough.npz").read_bytes()[:-30])
    said = fault(
        capsys, "render", folder / "lump.obj", "--material", path, "--engine", engine, "--out", tmp_path / "a.png"
    )
    assert said == f"mesoshell: {path}: not a zip file, or a truncated or damaged one\n"


def test_data_that_cannot_be_learned_from_are_named(folder, tmp_path, capsys) -> None:
    """Too few, or none at all."""
    wearing.write_patches(tmp_path / "one", [wearing.rows(64, 0, answer)])
    wearing.write_patches(tmp_path / "small", [wearing.rows(8, k, answer) for k in range(3)])
    given = ("train", EXPERIMENT, "--preset", "tiny", "--run", tmp_path / "run", "--data")
    assert "one: has 1 patch: one is held out" in fault(capsys, *given, tmp_path / "one")
    assert "small: has 8 queries in a patch; a step takes 16" in fault(capsys, *given, tmp_path / "small")
    assert "nothing: no such folder" in fault(capsys, *given, tmp_path / "nothing")


def test_a_plan_trains_nothing(folder, tmp_path, capsys) -> None:
    given = (
        "train",
        EXPERIMENT,
        "--preset",
        "tiny",
        "--data",
        folder / "patches",
        "--run",
        tmp_path / "run",
        "--dry-run",
    )
    main([str(x) for x in given])
    said = capsys.readouterr().out
    assert "surface: " in said and "GFLOP" in said and not (tmp_path / "run").exists()
    texels, first, last = 21 * sum(4**k for k in range(6)), 11 + 11 + 14, 1 + 1 + 3
    layers = 16 * first + 3 * 16 + 3 * 16 * 17 + 17 * last
    assert f"surface: {texels + layers:,} parameters" in said


def test_the_path_tracer_needs_no_jax(folder, tmp_path) -> None:
    out = tmp_path / "lump.png"
    given = ["render", folder / "lump.obj", "--material", folder / "rough.npz", "--engine", "mitsuba", "--size", 8, 8]
    command = [sys.executable, "-c", WITHOUT_JAX, *map(str, [*given, "--spp", 4, "--out", out])]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout == f"{out}\n", done.stderr
    assert read_png(out)[..., 3].max() > 0.5
