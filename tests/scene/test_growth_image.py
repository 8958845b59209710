"""An image says how high a material grows: in both engines, by the command and in Python; what is black stays bare."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro
from PIL import Image

import mesoshell as ms
import mesoshell.pathtracer
from mesoshell.cli.described_scene import scene_of as scene_of_words
from mesoshell.cli.main import main
from mesoshell.cli.options.render import Options
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_exr
from mesoshell.scene.growth import LEAST, _extruded, growth_of
from mesoshell.scene.settle import settle
from mesoshell.viewer.look import command, first_look, scene_of_look
from tests.helpers import wearing
from tests.helpers.path_traced import box, constant

HALF = np.repeat(np.array([[1.0, 0.0]], np.float32), 8, axis=1).repeat(16, axis=0)


@pytest.fixture
def fog(tiny_bundle: Bundle, tmp_path: Path) -> ms.Material:
    """Grey fog that lets half of the light through at its full height of 1 patch."""
    write_bundle(tmp_path / "fog.npz", constant(tiny_bundle, np.log(2), 0.2))
    return ms.load_material(tmp_path / "fog.npz")


def scene_of(material: ms.Material, **more: Any) -> ms.Scene:
    """The unit square from straight above, with a white floor under it."""
    given: dict[str, Any] = {"thickness": 0.05, "scale": 0.05, "size": (32, 32), "base_colour": (1.0, 1.0, 1.0)}
    given |= {"camera": (0.5, 0.5, 20.0, 0.5, 0.501, 0.0, 2.86), "up": "z", "lights": [(0.0, 0.0, 1.0)]}
    return ms.Scene(box(), material, **(given | more))


def test_a_shell_is_as_thick_as_the_image_is_bright(fog: ms.Material):
    ramp = np.broadcast_to((np.arange(64, dtype=np.float32) + 0.5) / 64, (64, 64))
    grown = growth_of(scene_of(fog, growth=ramp))
    offset = np.linalg.norm(grown.shell.offset, axis=1)
    used = np.unique(grown.shell.faces)
    np.testing.assert_allclose(
        offset[used], 0.05 * np.clip(grown.shell.base[used, 0], LEAST, 1 - 1 / 128), atol=1e-3 * 0.05
    )
    least = grown.shell.base[grown.shell.faces].max(axis=1)[:, 0].min()
    assert LEAST - 1e-3 <= least <= LEAST + 2 / 32  # what is darker carries none
    assert not any("left out" in note or "reduced" in note for note in grown.notes)


@pytest.mark.parametrize("engine", ["jax", "mitsuba"])
def test_black_is_bare_and_grey_is_lower(engine: Any, fog: ms.Material):
    """From above all that grows is as dense, for lengths in a shell are canonical; from aside it is as high as it is bright."""
    more: dict[str, Any] = {"spp": 64, "max_depth": 2} if engine == "mitsuba" else {}
    image = np.repeat(np.array([[1.0, 0.5, 0.0]], np.float32), [8, 8, 8], axis=1).repeat(24, axis=0)
    scene = scene_of(fog, growth=image)
    seen = ms.render(scene, "normal", engine=engine, density="network", **more).rgba[..., 0]
    found = [seen[12:20, k : k + 4].mean() for k in (3, 14, 25)]
    white, shell = 12 / np.pi, 0.2 * 12 * 0.5 + 12 / np.pi * 0.25
    np.testing.assert_allclose(found, [shell, shell, white], rtol=0.05)
    aside = replace(scene, camera=(0.5, -20.0, 0.025, 0.5, 0.5, 0.025, 2.86), size=(64, 64))
    alpha = ms.render(aside, "normal", engine=engine, density="network", **more).rgba[..., 3]
    high = [64 / 1.02 * alpha[:, k : k + 4].mean() / 64 / 0.05 for k in (8, 29, 52)]
    np.testing.assert_allclose(high, [1, 0.5, 0], atol=0.1)


def test_the_command_and_the_library_and_the_viewers_words_are_the_same(fog: ms.Material, tmp_path: Path):
    Image.fromarray((255 * HALF).astype(np.uint8)).save(tmp_path / "half.png")
    wearing.write_obj(tmp_path / "square.obj", wearing.square())
    given = ["render", str(tmp_path / "square.obj"), "--material", fog.name, "--growth", str(tmp_path / "half.png")]
    size = ["--size", "8", "8", "--quality", "draft", "--max-samples", "1", "--set", "density=network"]
    main([*given, "--thickness", "0.1", *size, "--out", str(tmp_path / "a.png")])
    scene = ms.Scene(tmp_path / "square.obj", fog, thickness=0.1, growth=tmp_path / "half.png", size=(8, 8))
    wanted = read_exr(tmp_path / "a.exr")
    changed = {"max_samples": 1, "density": "network"}
    np.testing.assert_array_equal(
        ms.render(scene, "draft", **changed).rgba.astype(np.float16), wanted.astype(np.float16)
    )
    still = settle(scene)
    assert isinstance(still.growth, np.ndarray)
    np.testing.assert_array_equal(
        ms.render(still, "draft", **changed).rgba.astype(np.float16), wanted.astype(np.float16)
    )
    assert isinstance(still.camera, ms.Camera)
    look = first_look(scene)
    words = command(scene, scene_of_look(scene, still, look, still.camera, False), look, "jax", 1)
    assert f"--growth {tmp_path / 'half.png'}" in words
    record = json.loads((tmp_path / "a.json").read_text())
    assert record["rays"] > 0


def test_of_a_further_material(fog: ms.Material, tmp_path: Path):
    """By the command: grey 128 of 255 is half as high."""
    Image.fromarray(np.full((8, 8), 128, np.uint8)).save(tmp_path / "grey.png")
    wearing.write_obj(tmp_path / "square.obj", wearing.square())
    wearing.write_obj(tmp_path / "other.obj", wearing.moved(wearing.square(), 3, 0, 0))
    words = [str(tmp_path / "square.obj"), "--material", fog.name, "--object", f"{tmp_path / 'other.obj'}={fog.name}"]
    words += ["--param", f"{fog.name}:growth={tmp_path / 'grey.png'}", "--param", f"{fog.name}:thickness=0.1"]
    scene = scene_of_words(tyro.cli(Options, args=words), fog)
    own, other = growth_of(scene), growth_of(scene.also[0])
    heights = [np.linalg.norm(x.shell.offset, axis=1).max() for x in (own, other)]
    assert heights[1] == pytest.approx(0.1 * 128 / 255, rel=1e-4) and len(np.unique(heights)) == 2


def test_an_island_keeps_parameters_and_textures_in_their_places(fog: ms.Material):
    """What is bare all around moves neither images of parameters nor where a texture begins."""
    disc = np.zeros((64, 64), np.float32)
    disc[20:44, 30:50] = 1
    island, whole = (growth_of(scene_of(fog, growth=x)) for x in (disc, np.ones((64, 64), np.float32)))
    assert len(island.shell.faces) < 0.3 * len(whole.shell.faces)
    assert island.patches_per_uv == pytest.approx(whole.patches_per_uv, rel=1e-5) == pytest.approx(20)
    assert island.origin == whole.origin
    uv = [_extruded(scene_of(fog, growth=x)).uv for x in (disc, np.ones((64, 64), np.float32))]
    assert [(x.min(), x.max()) for x in uv] == [(0, 20), (0, 20)]


def test_uneven_grass_shades_itself_in_mitsuba_and_jax_says_that_it_does_not(fog: ms.Material):
    flat, uneven = scene_of(fog), scene_of(fog, growth=HALF)
    assert (
        not ms.explain(flat, engine="mitsuba").shell_shadow.on and ms.explain(uneven, engine="mitsuba").shell_shadow.on
    )
    notes = [ms.render(x, "draft", max_samples=1).notes for x in (flat, uneven)]
    assert [any("casts no shadow on lower or bare places" in note for note in some) for some in notes] == [False, True]


def test_what_is_coarse_for_its_image_is_said(fog: ms.Material):
    fine, coarse = (growth_of(scene_of(fog, growth=np.ones((n, n), np.float32))).notes for n in (64, 4096))
    assert not fine and coarse == ("growth is read every 16 of its pixels: the mesh has 131072 triangles for it",)


def test_an_image_that_is_changed_in_place_grows_anew(fog: ms.Material):
    image, mesh = HALF.copy(), box()
    before = growth_of(replace(scene_of(fog, growth=image), mesh=mesh))
    assert growth_of(replace(scene_of(fog, growth=image), mesh=mesh)).shell is before.shell
    image[:] = 1
    assert len(growth_of(replace(scene_of(fog, growth=image), mesh=mesh)).shell.faces) > len(before.shell.faces)


@pytest.mark.parametrize(
    ("growth", "said"),
    [
        ("none.png", "growth: none.png is no image file"),
        (np.zeros((4, 4), np.float32), "growth: is black everywhere on the mesh: nothing grows"),
        (
            np.full((4, 4), 2, np.float32),
            "growth: must be an image (H, W) from 0 to 1; this one is (4, 4), from 2 to 2",
        ),
        (np.zeros((0, 4), np.float32), "growth: must be an image (H, W) from 0 to 1; this one is (0, 4)"),
    ],
    ids=["missing", "black", "bright", "empty"],
)
def test_faults_are_one_line(growth: Any, said: str, fog: ms.Material):
    with pytest.raises(InputError) as raised:
        ms.explain(scene_of(fog, growth=growth))
    assert str(raised.value).startswith(said) and "\n" not in str(raised.value)


def test_a_scene_of_mitsubas_has_none(fog: ms.Material, tmp_path: Path):
    with pytest.raises(InputError, match=r"^growth: a scene of Mitsuba's has one thickness a mesh$"):
        ms.write_scene(scene_of(fog, growth=HALF), tmp_path / "made")
    assert not (tmp_path / "made").exists()
