"""`mesoshell render --engine mitsuba` as a user calls it: the same files, with JAX out of reach; one line for each fault."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mesoshell.cli.main import main
from mesoshell.io.bundle import write_bundle
from mesoshell.io.image import read_exr, read_png, write_png

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
ENVIRONMENT = Path(__file__).parents[2] / ".venv-nojax"
#: `main` where nothing can import JAX.
WITHOUT_JAX = (
    "import sys; sys.modules.update(dict.fromkeys(('jax', 'jaxlib', 'flax', 'optax')))\n"
    "from mesoshell.cli.main import main; main(sys.argv[1:])"
)


@pytest.fixture(scope="module")
def material(tiny_bundle, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("material") / "tiny.npz"
    write_bundle(path, tiny_bundle)
    return path


def arguments(material: Path, out: Path, *more: object) -> list[str]:
    given = [
        "render",
        MESH,
        "--engine",
        "mitsuba",
        "--material",
        material,
        "--size",
        16,
        12,
        "--spp",
        4,
        "--out",
        out,
        *more,
    ]
    return [str(x) for x in given]


def test_a_picture_without_jax(material: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "monkey.png"
    command = [sys.executable, "-c", WITHOUT_JAX, *arguments(material, out, "--explain", "--param", "dryness=1")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout == f"{out}\n", done.stderr
    assert "on  shell shadow: light may cross shells on its way" in done.stderr
    linear, shown = read_exr(out.with_suffix(".exr")), read_png(out)
    assert linear.shape == shown.shape == (12, 16, 4) and np.isfinite(linear).all() and (linear >= 0).all()
    assert linear[0, 0, 3] == 0 and linear[6, 8, 3] == 1
    record = json.loads(out.with_suffix(".json").read_text())
    assert {"version", "engine", "seconds", "rays", "queries", "effects", "quality", "material"} <= record.keys()
    assert record["queries"] > 16 * 12
    assert (record["engine"], record["rays"], record["quality"]["spp"]) == ("mitsuba", 16 * 12 * 4, 4)
    assert record["quality"]["max_depth"] == 8 and "pixel_samples" not in record["quality"]


@pytest.mark.skipif(not (ENVIRONMENT / "installed").exists(), reason="no environment without JAX: make nojax")
def test_an_environment_without_jax(tmp_path: Path) -> None:
    python, out = str(ENVIRONMENT / "bin/python"), tmp_path / "monkey.png"
    assert subprocess.run([python, "-c", "import jax"], capture_output=True).returncode
    for command in (
        [python, "-c", "import mesoshell.pathtracer"],
        [str(ENVIRONMENT / "bin/mesoshell"), *arguments(Path("grass"), out)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert read_png(out)[..., 3].max() == 1


@pytest.mark.parametrize("light", [pytest.param("distant", marks=pytest.mark.slow), "sky"])
def test_the_engines_show_the_same(material: Path, tmp_path: Path, capsys, light: str) -> None:
    """One event, parameters by an image: pictures that are made in two ways. Only the path tracer knows that a shell dims what
    lights its other parts."""
    image = tmp_path / "halves.png"
    write_png(image, np.repeat([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]], 2, axis=0).astype(np.float32))
    plain = [str(MESH), "--material", str(material), "--size", "48", "48", "--param", f"dryness={image}"]
    mine, theirs = tmp_path / "m.png", tmp_path / "j.png"
    more = ["--environment", str(sky(tmp_path))] if light == "sky" else []
    main(["render", *plain, *more, "--engine", "mitsuba", "--max-depth", "2", "--spp", "128", "--out", str(mine)])
    main(["render", *plain, *more, "--out", str(theirs)])
    a, b = (read_exr(x.with_suffix(".exr")) for x in (mine, theirs))
    np.testing.assert_allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=0.15)
    blurred = [x[..., :3].reshape(12, 4, 12, 4, 3).mean(axis=(1, 3)) for x in (a, b)]
    assert np.corrcoef(blurred[0].ravel(), blurred[1].ravel())[0, 1] > 0.95


def sky(folder: Path) -> Path:
    """Blue above, red toward one side: what an axis that is wrong would show."""
    from mesoshell.io.image import write_exr

    image = np.full((16, 32, 4), 0.05, np.float32)
    image[:6, :, 2] = 2.0
    image[5:9, 8:13, 0] = 20.0
    write_exr(folder / "sky.exr", image)
    return folder / "sky.exr"


SCENE = """<scene version="3.0.0">
    <default name="dry" value="0"/>
    <integrator type="path"/>
    <sensor type="perspective">
        <transform name="to_world"> <lookat origin="-1.3, 2, 7.6" target="-2.49, 1.2, 4.1" up="0, 1, 0"/> </transform>
        <film type="hdrfilm"> <integer name="width" value="6"/> <integer name="height" value="4"/> {crop} </film>
        <sampler type="independent"> <integer name="sample_count" value="4"/> </sampler>
    </sensor>
    <emitter type="constant"/>
    <shape type="obj"> <string name="filename" value="{mesh}"/>
        <bsdf type="mesoshell"> <string name="material" value="{material}"/> <float name="dryness" value="$dry"/> </bsdf>
    </shape>
</scene>"""


def test_a_scene_of_mitsubas_takes_a_size_and_names(material: Path, tmp_path: Path, capsys) -> None:
    """Shells are made for the size that is asked for: footprints are those of its pixels."""
    scene = tmp_path / "scene.xml"
    scene.write_text(SCENE.format(crop="", mesh=MESH, material=material))

    def image(*more: str) -> np.ndarray:
        main(["render", str(scene), "--engine", "mitsuba", "--out", str(tmp_path / "a.png"), *more])
        return read_exr(tmp_path / "a.exr")

    own, wide = image(), image("--size", "12", "8")
    assert own.shape == (4, 6, 4) and wide.shape == (8, 12, 4)
    assert np.abs(image("--param", "dry=2") - own).max() > 1e-3
    shallow = '<integrator type="path"> <integer name="max_depth" value="2"/> </integrator>'
    scene.write_text(scene.read_text().replace('<integrator type="path"/>', shallow))
    passes = image("--max-samples", "64")
    goal = json.loads((tmp_path / "a.json").read_text())["goal"]
    assert goal["met"] == "max_samples" and goal["samples"]["least"] == 64
    np.testing.assert_allclose(passes.mean(axis=(0, 1)), image("--spp", "256").mean(axis=(0, 1)), rtol=0.03)
    capsys.readouterr()
    cropped = SCENE.format(crop='<integer name="crop_width" value="3"/>', mesh=MESH, material=material)
    (tmp_path / "cropped.xml").write_text(cropped)
    without = SCENE.replace("<film", "<!-- <film").replace("</film>", "</film> -->")
    (tmp_path / "without.xml").write_text(without.format(crop="", mesh=MESH, material=material))
    for given, said in (
        ([str(scene), "--param", "wet=2"], "wet"),
        ([str(tmp_path / "cropped.xml"), "--size", "12", "8"], "a film that is cropped keeps its own size"),
        ([str(tmp_path / "without.xml"), "--size", "12", "8"], "has no film that a size could be given to"),
        ([str(scene), "--size", "0", "8"], "--size: 0 x 8 has no pixels"),
        ([str(scene), "--size", "-1", "8"], "--size: -1 x 8 has no pixels"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["render", *given, "--engine", "mitsuba", "--out", str(tmp_path / "b.png")])
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("mesoshell: ") and said in line
    assert not (tmp_path / "b.png").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["render", "scene.xml"], "scene.xml: is a scene of Mitsuba's, which requires --engine mitsuba"),
        (["render", "scene.xml", "--engine", "mitsuba"], "scene.xml: no such file"),
        (["render", "scene.xml", "--engine", "mitsuba", "--seed", "3"], "--seed: is set in scene.xml"),
        (
            ["render", "scene.xml", "--engine", "mitsuba", "--grow", "Hill"],
            "--grow: names nodes of a glTF file or a USD stage: a scene of Mitsuba's says by its BSDFs what grows",
        ),
        (
            ["render", "scene.xml", "--engine", "mitsuba", "--holdout"],
            "--holdout: is for --engine jax: a scene of Mitsuba's holds nothing out",
        ),
        (["render", "scene.xml", "--engine", "mitsuba", "--set", "rr_depth=3"], "--set rr_depth: is set in scene.xml"),
        (["render", str(MESH), "--spp", "3"], "--spp: requires --engine mitsuba"),
        (["render", str(MESH), "--max-depth", "3"], "--max-depth: requires --engine mitsuba"),
        (["render", str(MESH), "--engine", "mitsuba", "--spp", "0"], "--spp: must be at least 1, not 0"),
    ],
)
def test_faults_are_one_line(given: list[str], said: str, capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main(given)
    assert stop.value.code == 2
    assert capsys.readouterr().err == f"mesoshell: {said}\n"


def test_a_libllvm_that_does_not_work_is_named(tmp_path: Path) -> None:
    bad = tmp_path / "libLLVM.so"
    bad.write_bytes(b"no library")
    command = [sys.executable, "-m", "mesoshell", "render", str(MESH), "--engine", "mitsuba"]
    done = subprocess.run(command, capture_output=True, text=True, env={"DRJIT_LIBLLVM_PATH": str(bad), "PATH": ""})
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert f"DRJIT_LIBLLVM_PATH: {bad} does not work" in done.stderr


def test_the_doctor_looks_at_mitsuba(capsys) -> None:
    main(["doctor"])
    assert "llvm_ad_rgb" in next(line for line in capsys.readouterr().out.splitlines() if line.startswith("mitsuba"))


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("import mitsuba as mi; mi.set_variant('scalar_rgb')", "variant scalar_rgb is set; shells need llvm_ad_rgb"),
        ("import sys; sys.modules['mitsuba'] = None", "is not installed: pip install"),
    ],
)
def test_a_mitsuba_that_cannot_do_it_is_named(code: str, said: str) -> None:
    """Dr.Jit is told of a libLLVM that works, so that only what is asked for is at fault."""
    from mesoshell.pathtracer.variant import library

    command = [sys.executable, "-c", f"{code}\nimport mesoshell.pathtracer"]
    done = subprocess.run(
        command, capture_output=True, text=True, env={"DRJIT_LIBLLVM_PATH": str(library()), "PATH": ""}
    )
    assert done.returncode == 1 and said in done.stderr.splitlines()[-1]
