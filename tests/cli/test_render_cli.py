"""`mesoshell render` as a user calls it: files and report of a success, and one line on standard error for each fault."""

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.commands.render import files_of
from mesoshell.cli.main import main
from mesoshell.geometry.mesh import uv_stretch
from mesoshell.io.bundle import write_bundle
from mesoshell.io.image import read_exr, read_png, write_exr
from mesoshell.scene import picture
from mesoshell.scene.accumulate import FIRST
from mesoshell.scene.materials import Material
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import describe_shell

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"


@pytest.fixture(scope="module")
def material(tiny_bundle, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("material") / "tiny.npz"
    write_bundle(path, tiny_bundle)
    return path


@pytest.fixture(autouse=True)
def _no_cache_at_home(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def arguments(material: Path, out: Path, *more: object) -> list[str]:
    given = ["render", MESH, "--material", material, "--size", 32, 32, "--quality", "draft", "--out", out, *more]
    return [str(x) for x in given]


@pytest.mark.parametrize(
    ("given", "stem"),
    [
        ("a", "a"),
        ("a.png", "a"),
        ("a.PNG", "a"),
        ("a.exr", "a"),
        ("a.json", "a"),
        ("age_0.25", "age_0.25"),
        ("v1.2.png", "v1.2"),
    ],
)
def test_a_dot_in_a_name_is_kept(given: str, stem: str):
    assert files_of(Path("out") / given) == tuple(Path(f"out/{stem}{kind}") for kind in (".png", ".exr", ".json"))


def test_a_picture_its_radiance_and_its_report(material: Path, tmp_path: Path, capsys):
    out = tmp_path / "new" / "folder" / "monkey.png"
    main(arguments(material, out, "--param", "dryness=1.5", "--explain"))
    said = capsys.readouterr()
    assert said.out == f"{out}\n"
    assert "mesh shadow: the mesh is not convex" in said.err
    assert sorted(p.name for p in out.parent.iterdir()) == ["monkey.exr", "monkey.json", "monkey.png"]
    linear, shown = read_exr(out.with_suffix(".exr")), read_png(out)
    assert linear.shape == shown.shape == (32, 32, 4)
    assert np.isfinite(linear).all() and (linear >= 0).all()
    assert linear[0, 0, 3] == 0 and linear[16, 16, 3] == 1  # the corner is empty, the middle is not
    record = json.loads(out.with_suffix(".json").read_text())
    required = {"version", "engine", "seconds", "rays", "queries", "effects", "quality", "material"}
    assert required <= record.keys()
    assert (record["engine"], record["rays"]) == ("jax", 32 * 32)
    assert record["queries"] > 0
    assert record["material"]["parameters"] == {"dryness": "1.5"}
    assert record["quality"]["samples"] == 10
    assert all(set(e) == {"on", "why"} for e in record["effects"].values())
    seconds = record["seconds"]
    assert all(v >= 0 for v in seconds.values())
    assert seconds["setup"] + seconds["wall"] <= seconds["total"]


def test_settings_change_a_preset_and_those_without_effect_are_said(material: Path, tmp_path: Path, capsys):
    more = ["--set", "samples=12", "--set", "coordinates=exact", "--set", "filtering=FALSE", "--set", "max_depth=3"]
    with pytest.raises(SystemExit):
        main(arguments(material, tmp_path / "no.png", *more))
    assert "--max-depth: requires --engine mitsuba" in capsys.readouterr().err
    more[-1] = "curve_length=1"
    main(arguments(material, tmp_path / "set.png", *more, "--set", "density=network"))
    assert "note: curve_length: has no effect on this picture" in capsys.readouterr().err
    used = json.loads((tmp_path / "set.json").read_text())["quality"]
    assert (used["samples"], used["coordinates"], used["filtering"]) == (12, "exact", False)
    assert used["early_stop"] == 0.05  # draft's


def test_a_goal_is_said_and_kept_in_the_report(material: Path, tmp_path: Path, capsys):
    out = tmp_path / "goal.png"
    given = [str(x) for x in ("render", MESH, "--material", material, "--size", 24, 24, "--out", out)]
    main([*given, "--error", "0.9", "--max-samples", "6"])
    assert "error reached: " in capsys.readouterr().err
    goal = json.loads(out.with_suffix(".json").read_text())["goal"]
    assert goal["promised"] == {"budget": None, "error": 0.9, "max_samples": 6}
    assert goal["met"] == "error" and goal["samples"]["most"] == FIRST and goal["bias"] >= 0
    assert goal["settings"]["samples"] == json.loads(out.with_suffix(".json").read_text())["quality"]["samples"]
    main([*given, "--quality", "draft", "--max-samples", "3", "--budget", "1e6"])
    assert "most samples taken: " in capsys.readouterr().err
    report = json.loads(out.with_suffix(".json").read_text())
    assert "settings" not in report["goal"] and report["goal"]["samples"]["mean"] == 3
    assert (report["quality"]["samples"], report["quality"]["pixel_samples"]) == (10, 3)


def test_ctrl_c_writes_the_passes_so_far(material: Path, tmp_path: Path, capsys, monkeypatch):
    whole = picture.render_pass

    def interrupted(camera, k, *rest):
        if k == 2:
            signal.raise_signal(signal.SIGINT)
        return whole(camera, k, *rest)

    monkeypatch.setattr(picture, "render_pass", interrupted)
    main(arguments(material, tmp_path / "a.png", "--max-samples", "50"))
    assert "interrupted: " in capsys.readouterr().err
    goal = json.loads((tmp_path / "a.json").read_text())["goal"]
    assert goal["met"] == "interrupt" and goal["samples"]["most"] == 2
    assert read_png(tmp_path / "a.png").std() > 0.1


@pytest.mark.parametrize("height", [0.25, 1.0])
def test_a_shell_has_the_proportions_of_its_material(tiny_bundle, height: float):
    """Unless it is asked to have others. Patches are resized by half of one in the UV unit at most."""
    material = Material("tiny", replace(tiny_bundle, thickness=height))
    for scene in (Scene(MESH, material), Scene(MESH, material, thickness=0.2), Scene(MESH, material, scale=0.3)):
        made = describe_shell(scene)
        patch = uv_stretch(made.mesh) / made.patches_per_uv
        tall = np.linalg.norm(made.shell.offset, axis=1).max() / patch
        assert tall == pytest.approx(height, rel=0.5 / made.patches_per_uv)
    made = describe_shell(Scene(MESH, material, thickness=0.2, scale=0.1))
    assert made.patches_per_uv == pytest.approx(round(uv_stretch(made.mesh) / 0.1))


def test_the_same_call_gives_the_same_bytes(material: Path, tmp_path: Path, capsys):
    sky = tmp_path / "sky.exr"
    write_exr(sky, np.random.default_rng(1).uniform(0, 1, (4, 8, 4)).astype(np.float32))
    for name in ("a", "b"):
        main(arguments(material, tmp_path / f"{name}.png", "--environment", sky))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert read_exr(tmp_path / "a.exr")[0, 0, 3] == 1  # the environment is seen behind the mesh


FAULTS = {
    "missing mesh": (["render", "no.obj"], "no.obj"),
    "unknown material": (["--material", "moss"], "moss"),
    "unknown parameter": (["--param", "wetness=1"], "wetness"),
    "unknown parameter as a map": (["--param", "wetness=map.png"], "wetness"),
    "missing map": (["--param", "dryness=map.png"], "map.png"),
    "value out of range": (["--param", "dryness=3"], "dryness"),
    "value not a number": (["--param", "dryness=nan"], "dryness"),
    "no value": (["--param", "dryness"], "--param"),
    "no size": (["--size", "0", "0"], "--size"),
    "missing environment": (["--environment", "no.exr"], "no.exr"),
    "missing object": (["--object", "no.ply"], "no.ply"),
    "no direction": (["--light", "0", "0", "0"], "--light"),
    "impossible camera": (["--camera", "0", "0", "1", "0", "0", "0", "180"], "--camera"),
    "eye on target": (["--camera", "0", "0", "1", "0", "0", "1", "40"], "--camera"),
    "eye nowhere": (["--camera", "nan", "0", "1", "0", "0", "1", "40"], "--camera"),
    "no thickness": (["--thickness", "0"], "thickness"),
    "thickness inside out": (["--thickness=-1"], "thickness"),
    "no scale": (["--scale", "0"], "scale"),
    "negative scale": (["--scale=-2"], "scale"),
    "infinite scale": (["--scale", "inf"], "scale"),
    "endless light": (["--light", "0", "1", "0", "--irradiance", "inf"], "--irradiance"),
    "no budget": (["--budget", "0"], "--budget: must be above 0 and finite, not 0.0"),
    "an error beyond any": (["--error", "1"], "--error: must be above 0 and below 1, not 1.0"),
    "no samples": (["--max-samples", "0"], "--max-samples: must be at least 1, not 0"),
    "two counts": (
        ["--budget", "1", "--set", "pixel_samples=2"],
        "--set pixel_samples: cannot be combined with a goal",
    ),
    "no setting": (["--set", "sample=3"], "--set sample: is no field of Quality; did you mean samples?"),
    "a setting's text": (["--set", "samples=many"], "--set samples: must be a whole number, not 'many'"),
    "a setting's switch": (["--set", "filtering=1"], "--set filtering: must be true or false, not '1'"),
    "a setting out of range": (["--set", "skip=1"], "--set skip: must lie in [0, 1), not 1.0"),
    "a setting of the other engine": (["--set", "spp=3"], "--spp: requires --engine mitsuba"),
    "a setting without a value": (["--set", "samples"], "--set: 'samples' is not NAME=VALUE"),
    "negative colour": (["--base", "0.1", "-0.1", "0.1"], "--base"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_line_that_names_it(fault: str, material: Path, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given, named = FAULTS[fault]
    out = tmp_path / "out" / "picture.png"
    with pytest.raises(SystemExit) as stop:
        main([*given, "--material", str(material)] if given[0] == "render" else arguments(material, out, *given))
    assert stop.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.startswith("mesoshell: ") and named in said.err
    assert list(tmp_path.iterdir()) == []


def test_debug_shows_the_traceback(material: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="moss"):
        main([*arguments(material, tmp_path / "x.png", "--material", "moss"), "--debug"])


@pytest.mark.parametrize("code", ["import mesoshell", "from mesoshell.cli.main import main; main(['--help'])"])
def test_nothing_loads_jax_before_it_is_needed(code: str):
    check = f"import sys\ntry:\n    {code}\nexcept SystemExit:\n    pass\nassert 'jax' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("verb", ["render", "materials", "fit", "dataset", "doctor"])
def test_every_verb_has_help(verb: str, capsys):
    with pytest.raises(SystemExit) as stop:
        main([verb, "--help"])
    assert stop.value.code == 0
    assert len(capsys.readouterr().out) > 100
