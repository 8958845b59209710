"""A scene that is written for Mitsuba is the scene that was described."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mesoshell as ms
import mesoshell.pathtracer
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.geometry.image_texture import Texture, codes_of
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_exr
from mesoshell.io.surface import write_surface
from mesoshell.render.mitsuba_frame import fitting_grid
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.materials import Material
from tests.helpers import wearing

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CAMERA = (0.5, 2.5, 9.0, -2.5, 1.25, 4.1, 30.0)


@pytest.fixture
def material(tiny_bundle: Bundle, tmp_path: Path) -> Material:
    write_bundle(tmp_path / "tiny grass.npz", tiny_bundle)
    return ms.load_material(tmp_path / "tiny grass.npz")


def described(material: Material, **more: Any) -> ms.Scene:
    return ms.Scene(MESH, material, **({"scale": 0.4, "camera": CAMERA, "size": (24, 20)} | more))


def values_of(path: Path) -> dict[str, str]:
    """Values of a scene's nodes, by name."""
    return {node.get("name", ""): node.get("value", "") for node in ET.parse(path).iter()}


def test_what_is_written(material: Material, tmp_path: Path):
    image = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    scene = described(material, params={"dryness": image}, objects=[MESH], lights=[(0.0, 1.0, 0.0)], irradiance=2.0)
    path = ms.write_scene(scene, tmp_path / "made", quality="draft")
    assert path == tmp_path / "made" / "scene.xml"
    names = {"scene.xml", "mesh.obj", "object0.obj", "param0.exr", "material.npz"}
    assert {file.name for file in path.parent.iterdir()} == names
    values = values_of(path)
    assert values["sample_count"] == "16" and values["max_depth"] == "4" and values["width"] == "24"
    assert values["material"] == "material.npz" and float(values["scale"]) == 0.4
    assert [float(x) for x in values["irradiance"].split(",")] == [2.0] * 3
    np.testing.assert_array_equal(read_exr(path.parent / "param0.exr")[::-1, :, 0], image)


def test_a_mesh_is_the_same_to_the_last_bit(material: Material, tmp_path: Path):
    """One without texture coordinates is written with those that it was given."""
    bare = tmp_path / "bare.obj"
    bare.write_text("".join(x for x in MESH.read_text().splitlines(True) if x.startswith("v ")) + faces_alone())
    path = ms.write_scene(ms.Scene(bare, material), tmp_path / "made")
    a, b = mesh_of(bare), load_mesh(path.with_name("mesh.obj"))
    np.testing.assert_array_equal(a.vertices[a.faces], b.vertices[b.faces])
    np.testing.assert_array_equal(a.uv, b.uv)


def faces_alone() -> str:
    lines = [x.split() for x in MESH.read_text().splitlines() if x.startswith("f ")]
    return "".join("f " + " ".join(corner.split("/")[0] for corner in line[1:]) + "\n" for line in lines)


def test_numbers_keep_all_their_digits(tmp_path: Path):
    """The largest angle is not above its range, as rounded it would be."""
    most = ms.load_material("carpet").parameters["lean_angle"].range[1]
    scene = ms.Scene(MESH, ms.load_material("carpet"), params={"lean_angle": most}, seed=2**32 - 1, scale=1 / 3)
    values = values_of(ms.write_scene(scene, tmp_path / "made"))
    assert float(values["lean_angle"]) == most and float(values["scale"]) == 1 / 3
    assert values["seed"] == str(2**32 - 1) and values["material"] == "carpet"


def test_what_cannot_be_written_leaves_nothing(
    material: Material, tiny_bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    there = tmp_path / "there"
    there.mkdir()
    monkeypatch.chdir(tmp_path)
    carpet = ms.load_material("carpet")
    priced = (replace(tiny_bundle.parameters[0], name="cost$"), *tiny_bundle.parameters[1:])
    write_bundle(tmp_path / "priced.npz", replace(tiny_bundle, parameters=priced))
    for scene, folder, said in (
        (described(material), there, "exists already"),
        (described(Material("unnamed", tiny_bundle)), tmp_path / "a", "^unnamed: is a material in no file"),
        (described(Material("there", tiny_bundle)), tmp_path / "a", "^there: is a material in no file"),
        (described(ms.load_material(tmp_path / "priced.npz"), params={"cost$": 0.5}), tmp_path / "a", "holds a \\$"),
        (described(carpet, params={"hue": 9.0}), tmp_path / "a", "hue=9 lies outside"),
        (described(carpet, params={"lean": float("nan")}), tmp_path / "a", "lean=nan lies outside"),
        (described(carpet, base_colour=(2.0, 0.0, 0.0)), tmp_path / "a", "base_colour"),
        (described(carpet, seed=2**40), tmp_path / "a", "seed"),
        (described(carpet, latent=(3, 0.5)), tmp_path / "a", "^latent: carpet has no latent z"),
        (described(material, params={"dryness": 9.0}), tmp_path / "b", "dryness=9 lies outside"),
        (described(material, seed=3), tmp_path / "c", "seed"),
    ):
        before = sorted(tmp_path.iterdir())
        with pytest.raises(InputError, match=said):
            ms.write_scene(scene, folder)
        assert sorted(tmp_path.iterdir()) == before


def test_the_command_says_its_faults(material: Material, tmp_path: Path, capsys: pytest.CaptureFixture):
    given = [str(MESH), "--material", material.name]
    for options, said in (
        ([*given, "--engine", "mitsuba"], "--engine: has no effect here"),
        (["scene.xml"], "scene.xml: is a scene of Mitsuba's already"),
        ([*given, "--out", str(tmp_path)], "exists already"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(["scene", *options])
        assert caught.value.code == 2 and said in capsys.readouterr().err
    main(["scene", *given, "--size", "20", "10", "--out", str(tmp_path / "new")])
    assert capsys.readouterr().out.strip() == str(tmp_path / "new" / "scene.xml")


@pytest.mark.parametrize("kind", [pytest.param("lights", marks=pytest.mark.slow), "sky"])
def test_it_is_the_picture_of_the_described_scene(kind: str, tmp_path: Path):
    """By its mean, and pixel by pixel up to noise; what is off by a mirror or a turn is not."""
    image = np.outer(np.linspace(0, 1, 8), np.linspace(1, 0, 8)).astype(np.float32)
    more: dict[str, Any] = {"params": {"age": image}, "base_colour": (0.4, 0.2, 0.1), "thickness": 0.15}
    if kind == "sky":
        sky = np.full((8, 16, 3), 0.1, np.float32)
        sky[1:3, 2:5] = (9.0, 5.0, 2.0)
        more |= {"environment": sky, "transparent": True, "up": "z"}
    scene = described(ms.load_material("grass"), **more)
    wanted = ms.render(scene, "normal", engine="mitsuba", spp=256).rgba
    path = ms.write_scene(scene, tmp_path / "made")
    made = np.array(mitsuba().render(ms.mitsuba.load_file(path), spp=256))
    assert made.shape == wanted.shape
    np.testing.assert_allclose(made[..., 3], wanted[..., 3], atol=0.08)
    np.testing.assert_allclose(made.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=0.02)
    away = np.abs(made - wanted)[..., :3].mean()
    assert away < 0.1 * wanted[..., :3].mean() < 0.3 * np.abs(made[:, ::-1] - wanted)[..., :3].mean()


def test_an_image_on_an_object_is_written_too(material: Material, tmp_path: Path):
    """The picture is the same, noise apart; without the image it is not."""
    codes = np.random.default_rng(0).integers(0, 256, (2, 3, 3)).astype(np.uint8)
    board = replace(
        load_mesh(MESH.with_name("spot.obj")), texture=Texture(codes_of(Image.fromarray(codes))), colour=(1.0, 1.0, 1.0)
    )
    scene = ms.Scene(MESH, material, objects=[board], size=(24, 20), camera=(1.5, 0.5, -3.0, 0.0, 0.0, 0.0, 40.0))
    path = ms.write_scene(scene, tmp_path / "made", quality="draft")
    assert {"object0.obj", "albedo0.exr"} <= {file.name for file in path.parent.iterdir()}
    plain = replace(scene, objects=[replace(board, texture=None)])
    wanted, other = (ms.render(x, "draft", engine="mitsuba", spp=256).rgba[..., :3] for x in (scene, plain))
    written = np.array(mitsuba().render(ms.mitsuba.load_file(path), spp=256))[..., :3]
    np.testing.assert_allclose(written.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=0.02)
    assert np.abs(written - wanted).mean() < 0.1 * np.abs(written - other).mean()


def test_a_surface_material_is_written_too(tmp_path: Path):
    write_surface(tmp_path / "dots.npz", wearing.bundle())
    scene = described(ms.load_material(tmp_path / "dots.npz"), size=(12, 10))
    made = np.array(mitsuba().render(ms.mitsuba.load_file(ms.write_scene(scene, tmp_path / "made")), spp=64))
    wanted = ms.render(scene, "normal", engine="mitsuba", spp=64).rgba
    assert wanted[..., :3].mean() > 0
    np.testing.assert_allclose(made.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=0.05)


def mitsuba() -> Any:
    assert ms.mitsuba.load_file  # names a libLLVM that works
    import mitsuba as mi

    return mi


@pytest.mark.parametrize("samples", [*range(1, 26), 48, 97, 512])
def test_a_sampler_is_told_of_no_number_that_it_would_round_up(samples: int) -> None:
    fits = fitting_grid(samples)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": fits})
    assert sampler.sample_count() == fits == fitting_grid(fits) and samples / 2 < fits <= samples


def test_a_number_of_paths_that_is_no_grid_is_kept(material: Material, tmp_path: Path) -> None:
    path = ms.write_scene(described(material), tmp_path / "scene", quality=ms.Quality(spp=5))
    (sampler,) = ET.parse(path).iter("sampler")
    assert sampler.get("type") == "independent" and sampler[0].get("value") == "5"
