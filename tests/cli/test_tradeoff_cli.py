"""`mesoshell tradeoff` as a user calls it, and `ms.tradeoff`, on both engines; one line for each fault."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_png
from mesoshell.io.surface import write_surface
from mesoshell.render.quality import PRESETS
from mesoshell.scene.materials import Material
from mesoshell.scene.render_paths import prepare_file
from mesoshell.tradeoff import points, reference, run
from mesoshell.tradeoff.knobs import VALUES, describe_changes
from tests.helpers import wearing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
WITHOUT_JAX = (
    "import sys; sys.modules.update(dict.fromkeys(('jax', 'jaxlib', 'flax', 'optax')))\n"
    "from mesoshell.tradeoff import points, reference, run; run.MAX_POINTS, run.AIM = 2, 0.5\n"
    "points.MAX_PASSES, reference.MIN_PASSES = {False: 8}, 4\n"
    "from mesoshell.cli.main import main; main(sys.argv[1:])"
)


@pytest.fixture(scope="module", autouse=True)
def _no_cache_at_home(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        yield


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two points, and a reference of few passes, however long they take."""
    monkeypatch.setattr(run, "MAX_POINTS", 2)
    monkeypatch.setattr(run, "AIM", 0.5)


@pytest.mark.slow  # with as many passes as a user's
@pytest.mark.parametrize(("engine", "passes"), [("jax", (1, 2, 4, 8)), ("mitsuba", (1, 2, 4, 8, 16, 32, 64))])
def test_a_surface_material(few, tmp_path: Path, engine: Literal["jax", "mitsuba"], passes: tuple[int, ...]) -> None:
    scene = ms.Scene(MESH, Material("dots", wearing.bundle()), scale=0.4, size=(16, 12))
    said: list[tuple[float, str]] = []
    made = ms.tradeoff(scene, tmp_path, engine=engine, minutes=60.0, progress=lambda *now: said.append(now))
    assert made.points[0].samples == passes and made.front[0].flip > made.front[-1].flip > 0
    assert {"curvature_filter", "curve_length"} <= set(made.names) and "samples" not in made.names
    assert said[0][1] == "reference" and said[-1][1] == describe_changes(made.points[-1].settings)
    assert (tmp_path / "report.html").exists()


@pytest.mark.parametrize("kind", [pytest.param("shell", marks=pytest.mark.slow), "surface"])
def test_the_command_without_jax(tiny_bundle: Bundle, tmp_path: Path, kind: str) -> None:
    material, out = tmp_path / "tiny.npz", tmp_path / "new" / "folder"
    write_bundle(material, tiny_bundle) if kind == "shell" else write_surface(material, wearing.bundle())
    given = ["tradeoff", MESH, "--engine", "mitsuba", "--material", material, "--size", 16, 12, "--out", out]
    given += [] if kind == "shell" else ["--scale", 0.4]
    command = [sys.executable, "-c", WITHOUT_JAX, *map(str, given)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("takes 10 minutes (--minutes), until ") and "Traceback" not in done.stderr
    *table, last = done.stdout.splitlines()
    assert table[0].startswith("2 settings, ") and last == f"{out}/report.html" and (out / "report.html").exists()
    told = json.loads((out / "front.json").read_text())
    assert len(told["seconds"]) == len(table) - 1 and told["seconds"][0]["settings"].keys() <= {*VALUES}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["scene.xml"], "scene.xml: is a scene of Mitsuba's, which requires --engine mitsuba"),
        (["scene.xml", "--engine", "mitsuba", "--seed", "3"], "--seed: is set in scene.xml"),
        ([str(MESH), "--minutes", "0"], "--minutes: must be above 0, not 0"),
        ([str(MESH), "--minutes", "nan"], "--minutes: must be above 0, not nan"),
        (["none.obj"], "none.obj: no such file"),
        ([str(MESH), "--out", str(MESH)], f"{MESH}: is a file"),
        ([str(MESH), "--size", "0", "3"], "--size: 0 x 3 has no pixels"),
    ],
)
def test_faults_are_one_line(given: list[str], said: str, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["tradeoff", *given])
    assert stop.value.code == 2
    told = capsys.readouterr().err.splitlines()
    assert told[-1] == f"mesoshell: {said}" and len(told) <= 2
    assert not any(tmp_path.iterdir())


SCENE = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="-2.2,2,9" target="-2.5,1.2,4" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="32"/><rfilter type="box"/></film>
    </sensor>
    <emitter type="directional"><vector name="direction" value="-0.3,-1,-0.2"/></emitter>
    <shape type="obj"><string name="filename" value="MESH"/>
        <bsdf type="mesoshell"><string name="material" value="tiny.npz"/><float name="thickness" value="0.2"/></bsdf></shape>
</scene>
"""


def test_a_scene_of_mitsubas(few, tiny_bundle: Bundle, tmp_path: Path, capsys, monkeypatch) -> None:
    """Its film is made smaller in its own proportions, and its path depth is its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(points, "MAX_PASSES", {False: 8})
    monkeypatch.setattr(reference, "MIN_PASSES", 4)
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    (tmp_path / "scene.xml").write_text(SCENE.replace("MESH", str(MESH)))
    main(["tradeoff", "scene.xml", "--engine", "mitsuba", "--size", "16", "12", "--out", "found"])
    assert capsys.readouterr().out.splitlines()[-1] == "found/report.html"
    assert read_png(tmp_path / "found/reference.png").shape[:2] == (9, 19)
    point = json.loads((tmp_path / "found/points.json").read_text())["points"][0]
    assert "samples" in point["settings"] and not {"max_depth", "rr_depth"} & point["settings"].keys()
    assert "--set spp=" in (tmp_path / "found/report.html").read_text()
    ready = prepare_file(tmp_path / "scene.xml", PRESETS["normal"], None, pixels=192)
    assert ready.passes(PRESETS["reference"]).ended(np.zeros((9, 19, 4)), 1).record["quality"]["max_depth"] == 3
    with pytest.raises(ms.InputError, match=r"^pixels: must be at least 1"):
        ms.tradeoff("scene.xml", "other", engine="mitsuba", pixels=0)
