"""The library as a user imports it: light to import, the command line's pictures, and faults that name the argument."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import write_bundle
from mesoshell.io.image import read_exr, read_png
from mesoshell.io.material import bundled_materials
from mesoshell.io.surface import write_surface
from tests.helpers import wearing

ROOT = Path(__file__).parents[2]
MESH = ROOT / "tests/data/suzanne.obj"
SIZE = (32, 24)


@pytest.fixture(scope="module", autouse=True)
def _no_cache_at_home(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        yield


@pytest.fixture(scope="module")
def folder(tiny_bundle, tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("materials")
    write_bundle(made / "shell.npz", tiny_bundle)
    write_surface(made / "surface.npz", wearing.bundle())
    return made


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_loads_nothing_else() -> None:
    """Not one package that is not Python's own: so it takes hundredths of a second."""
    code = "import sys; old = set(sys.modules); import mesoshell; print(*{m.split('.')[0] for m in set(sys.modules) - old})"
    assert set(python(code).split()) - sys.stdlib_module_names == {"mesoshell"}


def test_nothing_loads_jax_before_it_is_needed() -> None:
    """Not even materials and scenes, nor what there is to know of the functions that need it."""
    python(f"""
import sys, inspect
import mesoshell as ms
material = ms.load_material("grass")
scene = ms.Scene({str(MESH)!r}, material, params={{"age": 0.3}}, lights=[(0.0, 1.0, 0.0)])
ms.Picture, ms.Camera, ms.Distant, ms.Quality, ms.InputError, ms.explain, inspect.signature(ms.render), dir(ms)
assert not {{"jax", "mitsuba"}} & sys.modules.keys()
""")


def test_all_names_are_there() -> None:
    assert set(ms.__all__) <= set(dir(ms))
    for name in ms.__all__:
        assert getattr(ms, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'rendered'"):
        _ = ms.rendered  # type: ignore[attr-defined]


def test_rooms_that_are_functions_stay_rooms() -> None:
    """Whichever is used first; and their arguments are known."""
    python("import mesoshell.render.camera as camera, mesoshell as ms; assert callable(ms.render) and camera.look_at")
    python("import mesoshell as ms; callable(ms.train); from mesoshell.train import report; import mesoshell.train.run")
    assert list(inspect.signature(ms.render).parameters) == [
        "scene",
        "quality",
        "engine",
        "budget",
        "error",
        "max_samples",
        "progress",
        "changes",
    ]
    assert list(inspect.signature(ms.train).parameters)[:3] == ["config", "data", "folder"]


def test_public_names_say_what_they_are() -> None:
    """With units and errors where there are any; each field of a scene is said."""
    for name in set(ms.__all__) - {"__version__"}:
        found = getattr(ms, name)
        text = inspect.getdoc(found.__call__ if inspect.ismodule(found) and callable(found) else found)
        assert text and len(text) > 40, name
    for name in inspect.signature(ms.Scene).parameters:
        assert re.search(rf"^{name}: ", inspect.getdoc(ms.Scene) or "", re.MULTILINE), name


def test_parameters_of_bundled_materials_are_documented() -> None:
    for name in bundled_materials():
        material = ms.load_material(name)
        assert material.kind == "shell" and material.provenance and material.parameters
        for parameter in material.parameters.values():
            low, high = parameter.range
            assert low <= parameter.default <= high and parameter.unit and len(parameter.meaning) > 10


@pytest.mark.parametrize(
    ("engine", "kind"),
    [
        ("jax", "shell"),
        pytest.param("jax", "surface", marks=pytest.mark.slow),
        pytest.param("mitsuba", "shell", marks=pytest.mark.slow),
        ("mitsuba", "surface"),
    ],
)
def test_a_picture_is_the_command_lines(folder: Path, tmp_path: Path, capsys, kind: str, engine: Any) -> None:
    """Bit for bit, with the same report but for seconds, and the same notes."""
    out, few = tmp_path / "cli.png", {"spp": 3} if engine == "mitsuba" else {}
    given = ["render", MESH, "--material", folder / f"{kind}.npz", "--size", *SIZE, "--engine", engine, "--out", out]
    given += ["--scale", 0.4, "--light", -0.3, 0.9, 0.2, "--irradiance", 4, "--quality", "draft"]
    given += ["--param", "dryness=1.5"] if kind == "shell" else []
    main([str(x) for x in (*given, *(("--spp", 3) if few else ()))])
    material = ms.load_material(folder / f"{kind}.npz")
    params = {"dryness": 1.5} if kind == "shell" else {}
    scene = ms.Scene(
        str(MESH), material, scale=0.4, params=params, size=SIZE, lights=[(-0.3, 0.9, 0.2)], irradiance=4.0
    )
    shares: list[float] = []
    picture = ms.render(scene, "draft", engine=engine, progress=shares.append, **few)
    assert picture.rgba.dtype == np.float32 and picture.rgba.shape == (SIZE[1], SIZE[0], 4)
    assert shares[-1] == pytest.approx(1.0) and shares == sorted(shares)
    for suffix in (".png", ".exr"):
        picture.save(tmp_path / f"api{suffix}")
        assert (tmp_path / f"api{suffix}").read_bytes() == out.with_suffix(suffix).read_bytes()
    record = json.loads(out.with_suffix(".json").read_text())
    mine = json.loads(json.dumps(picture.report))
    assert mine.pop("seconds").keys() == record.pop("seconds").keys()
    record.pop("compile_seconds", None)
    assert record["material"].pop("parameters") == {k: str(v) for k, v in params.items()}
    assert mine["material"].pop("parameters") == params
    assert mine == record
    said = re.sub(r"\s+", " ", capsys.readouterr().err)
    assert all(re.sub(r"\s+", " ", note) in said for note in picture.notes)


def test_a_picture_displays_itself_and_is_saved_by_its_name(folder: Path, tmp_path: Path) -> None:
    rgba = np.random.default_rng(0).random((4, 5, 4), np.float32)
    picture = ms.Picture(rgba, {})
    picture.save(str(tmp_path / "a.png"))
    assert picture._repr_png_() == (tmp_path / "a.png").read_bytes()
    assert read_png(tmp_path / "a.png").shape == (4, 5, 4)
    picture.save(tmp_path / "a.EXR")
    np.testing.assert_allclose(read_exr(tmp_path / "a.EXR"), rgba, atol=1e-3)
    with pytest.raises(ms.InputError, match=r"^path: .*b.jpg must end in .png or .exr$"):
        picture.save(tmp_path / "b.jpg")


def test_effects_are_explained(folder: Path) -> None:
    """As they are printed with --explain; nothing is rendered."""
    scene = ms.Scene(MESH, ms.load_material(folder / "shell.npz"), size=SIZE)
    effects = ms.explain(scene, "draft")
    lines = str(effects).splitlines()
    assert "on  mesh shadow: the mesh is not convex" in lines and len(lines) == len(vars(effects))
    assert effects.baked_density.on and not effects.filtering.on
    network = ms.explain(scene, "draft", density="network")
    assert network.filtering.on and not ms.explain(scene, "draft", density="network", filtering=False).filtering.on


def test_files_and_what_was_loaded_are_alike(folder: Path, tmp_path: Path) -> None:
    """Of meshes, images, environments and cameras."""
    from mesoshell.geometry.mesh import load_mesh
    from mesoshell.io.image import write_exr

    ramp = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    sky = np.random.default_rng(1).random((4, 8, 3), np.float32).astype(np.float16).astype(np.float32)
    write_exr(tmp_path / "ramp.exr", np.repeat(ramp[..., None], 3, axis=2), half=False)
    write_exr(tmp_path / "sky.exr", sky)
    material = ms.load_material(folder / "shell.npz")
    eye, target = (0.0, 1.0, 4.0), (0.0, 0.0, 0.0)
    numbers = (*eye, *target, 40.0)
    camera = ms.Camera(ms.look_at(eye, target), float(np.radians(40.0)), *SIZE)
    of_files: dict[str, Any] = {"params": {"dryness": tmp_path / "ramp.exr"}, "environment": tmp_path / "sky.exr"}
    loaded: dict[str, Any] = {"params": {"dryness": ramp}, "environment": sky}
    one = ms.render(ms.Scene(MESH, material, camera=numbers, size=SIZE, **of_files), "draft")
    two = ms.render(ms.Scene(load_mesh(MESH), material, camera=camera, **loaded), "draft")
    np.testing.assert_allclose(one.rgba, two.rgba, atol=1e-5)
    assert one.report["effects"] == two.report["effects"] and one.report["effects"]["varying_parameters"]["on"]
    assert one.report["material"]["parameters"] == {"dryness": str(tmp_path / "ramp.exr")}
    assert two.report["material"]["parameters"] == {"dryness": "an image of 3 x 4"}
    json.dumps(two.report)


NAN = float("nan")
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "a parameter that is none": ({"params": {"drynes": 1.0}}, "params: no parameter 'drynes'; did you mean dryness?"),
    "out of range": ({"params": {"dryness": 3.0}}, r"params: dryness=3 lies outside \[0, 2\]"),
    "no number": ({"params": {"dryness": "wet"}}, "params: dryness=wet is neither a number nor an image file"),
    "no image": (
        {"params": {"dryness": np.full((2, 2), 2.0)}},
        "params: dryness, an image, holds values outside 0 to 1",
    ),
    "no thickness": ({"thickness": 0.0}, "thickness: must be positive and finite, not 0"),
    "no scale": ({"scale": NAN}, "scale: must be positive and finite, not nan"),
    "thin patches": ({"thickness": 1e-9}, "thickness: 1e-09 makes patches too small for this mesh: give `scale`"),
    "no light": ({"lights": [(0.0, 0.0, 0.0)]}, r"lights: \(0.0, 0.0, 0.0\) is no direction"),
    "dark light": ({"lights": [ms.Distant(np.ones(3), np.array([1.0, -1.0, 1.0]))]}, "lights: must be from 0 to 1e"),
    "endless light": ({"irradiance": float("inf")}, "irradiance: must be from 0 to 1e"),
    "bright ground": ({"base_colour": (0.1, 2.0, 0.1)}, "base_colour: must be from 0 to 1"),
    "no pixels": ({"size": (0, 4)}, "size: 0 x 4 has no pixels"),
    "few numbers": ({"camera": (0.0, 0.0, 1.0)}, "camera: holds 3 numbers: eye, target and field of view are 7"),
    "wide camera": ({"camera": (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 180.0)}, "camera: a field of view of 180 degrees"),
    "no seeds": ({"seed": 3}, r"seed: .*shell.npz is one texture and has no generator"),
    "a dark sky": ({"environment": np.zeros((2, 4, 3))}, "environment: holds negative light, no light"),
    "no object": ({"objects": ["none.obj"]}, "none.obj: no such file"),
    "no mesh": ({"mesh": "none.obj"}, "none.obj: no such file"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_names_the_argument(fault: str, folder: Path) -> None:
    given, said = FAULTS[fault]
    scene = {"mesh": MESH, "material": ms.load_material(folder / "shell.npz"), "size": SIZE} | given
    with pytest.raises(ms.InputError, match=f"^{said}"):
        ms.explain(ms.Scene(**scene))


def test_faults_of_a_render_and_of_surface_materials(folder: Path) -> None:
    shell, surface = (ms.load_material(folder / f"{kind}.npz") for kind in ("shell", "surface"))
    scene = ms.Scene(MESH, shell, size=SIZE)
    cases: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("best", {}, "quality: must be a Quality or one of draft, normal, reference, not best"),
        ("draft", {"sampels": 3}, "sampels: is no field of Quality; did you mean samples"),
        ("draft", {"samples": 0}, "samples: must be at least 1, not 0"),
        ("draft", {"spp": 3}, "spp: requires `engine` mitsuba"),
        ("draft", {"engine": "mitsuba", "spp": 0}, "spp: must be at least 1, not 0"),
        ("draft", {"engine": "mitsuba", "spacing": "interval"}, "spacing: 'interval' requires `engine` jax"),
    )
    for quality, changes, said in cases:
        with pytest.raises(ms.InputError, match=f"^{said}"):
            ms.explain(scene, quality, **changes)
    given: tuple[dict[str, Any], ...] = ({"params": {"dryness": 1.0}}, {"seed": 0}, {"thickness": 0.1})
    for more in given:
        with pytest.raises(ms.InputError, match=rf"^{min(more)}: .*surface.npz is a surface material: it has none"):
            ms.explain(ms.Scene(MESH, surface, **more))
    with pytest.raises(ms.InputError, match=r"^moss: no such material"):
        ms.load_material("moss")
    python(f"""
import mesoshell as ms
try:
    ms.Scene({str(MESH)!r}, "grass")
except ms.InputError as error:
    assert str(error) == "material: must be a Material, as load_material gives, not 'grass'"
else:
    raise AssertionError
""")
    assert surface.kind == "silhouette" and surface.parameters == {}


#: What only a program that checks no types can ask for.
STRANGE = """
import mesoshell as ms, numpy as np
material = ms.load_material({shell!r})
def fault(call, said):
    try:
        call()
    except ms.InputError as error:
        assert str(error).startswith(said), str(error)
    else:
        raise AssertionError(said)
def explained(quality="draft", engine="jax", changes={{}}, **more):
    return lambda: ms.explain(ms.Scene({mesh!r}, material, **{{"size": (8, 6)}} | more), quality, engine=engine, **changes)
for value in ([[0.0, 1.0]], None, "a" * 300):
    fault(explained(params={{"dryness": value}}), "params: dryness=")
for latent in (3, (3,), (3.5, 0.5), (3, "half"), (3, None)):
    fault(explained(latent=latent), "latent: must be another seed and its share, not")
for size in (64, (64,), (64.5, 32)):
    fault(explained(size=size), "size: must be two whole numbers")
far = ms.Camera(ms.look_at((0, 0, 1e38), (0, 0, 0)), 0.5, 8, 6)
fault(explained(camera=far), "camera: holds a number beyond")
fault(explained(camera=ms.Camera(np.eye(4), 0.5, 10**6, 10**6)), "camera: a picture of")
for colour in (0.1, (0.1, 0.1)):
    fault(explained(base_colour=colour), "base_colour: must be three numbers")
fault(explained(objects="cow.obj"), "objects: must be a list of meshes")
fault(explained(quality=None), "quality: must be a Quality or one of")
fault(explained(changes={{"samples": 16.5}}), "samples: must be a whole number, not 16.5")
fault(explained(changes={{"filtering": 1}}), "filtering: must be true or false, not 1")
fault(explained(engine="mitsuba", changes={{"spp": "x"}}), "spp: must be a whole number, not 'x'")
fault(lambda: ms.Camera(np.eye(4), 4.0, 8, 6), "fov: must be between 0 and π radians")
fault(lambda: ms.look_at((float("nan"), 0, 0), (0, 0, 0)), "eye: eye or target is not finite")
fault(lambda: ms.train("x.py", "data", "run", preset="huge"), "preset: must be one of tiny")
fault(lambda: ms.train("x.py", "data", "run", parallel="foo"), "parallel: must be jit or pmap")
fault(lambda: ms.train({{"a": 1}}, "data", "run"), "config: {{'a': 1}} is neither")
fault(lambda: ms.fit(["data"], test="fog"), "test: must be a list")
assert explained(params={{"dryness": np.float32(0.3)}})() and explained(changes={{"samples": np.int64(7)}})()
import json
small = ms.Scene({mesh!r}, material, params={{"dryness": np.float32(0.5)}}, size=(4, 3))
json.dumps(ms.render(small, "draft", engine="mitsuba", spp=1).report)
"""


def test_values_of_other_kinds_are_one_line_too(folder: Path) -> None:
    python(STRANGE.format(shell=str(folder / "shell.npz"), mesh=str(MESH)))


def test_faults_of_fits_and_runs(tmp_path: Path) -> None:
    with pytest.raises(ms.InputError, match=r"^datasets: must be a list"):
        ms.fit("data/grass")
    with pytest.raises(ms.InputError, match=r"^texels: 3 is not a power of two"):
        ms.fit([tmp_path], texels=3)
    with pytest.raises(ms.InputError, match=r"none.py: no such file"):
        ms.train(tmp_path / "none.py", tmp_path, tmp_path / "run")
    with pytest.raises(ms.InputError, match=r"^kimg: must be above 0"):
        ms.train(ROOT / "experiments/weave_silhouette.py", tmp_path, tmp_path / "run", kimg=0.0)
    assert list(tmp_path.iterdir()) == []


def test_nothing_outside_the_command_line_imports_it() -> None:
    """Within the package import-linter sees to it. A benchmark of a whole command may call it."""
    files = [p for name in ("benchmarks", "notebooks", "experiments") for p in (ROOT / name).glob("*.py")]
    found = {p.name for p in files if re.search(r"\bmesoshell\.cli\b", p.read_text())}
    assert len(files) > 30 and found <= {"accelerator.py"}


@pytest.mark.slow
def test_a_seed_lays_corner_tiles_in_another_order(tiled_bundle, tmp_path: Path) -> None:
    """The same seed gives the same picture, another seed another one; both engines see the same plane."""
    write_bundle(tmp_path / "tiles.npz", tiled_bundle)
    material = ms.load_material(tmp_path / "tiles.npz")

    def seen(seed: int | None, **more: Any) -> np.ndarray:
        lit: dict[str, Any] = {"size": (32, 32), "lights": [(0.3, 0.9, 0.2)], "transparent": True}
        scene = ms.Scene(MESH, material, seed=seed, scale=0.5, thickness=0.1, **lit)
        return np.log1p(ms.render(scene, "draft", **more).rgba[..., :3])

    ours = {seed: seen(seed) for seed in (0, 5)}
    np.testing.assert_array_equal(ours[0], seen(None))
    assert np.abs(ours[0] - ours[5]).mean() > 0.02
    for seed, other in ((0, 5), (5, 0)):
        theirs = seen(seed, engine="mitsuba", spp=128)
        assert np.abs(theirs - ours[seed]).mean() < 0.9 * np.abs(theirs - ours[other]).mean()
