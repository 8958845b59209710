"""What is set is what is shown, and what the command line says."""

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_exr
from mesoshell.scene.materials import Material
from mesoshell.scene.settled import settled
from mesoshell.viewer.look import Look, asked, command, first_look, shown, sized, toward_sun
from tests.helpers import growing, wearing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CAMERA = ms.Camera(ms.look_at((1.0, 2.0, 9.0), (0.0, 0.0, 0.0)), 0.6, 20, 16)


@pytest.fixture(autouse=True)
def _no_cache_at_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def begun(tiny_bundle: Bundle) -> ms.Scene:
    scene = ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, size=(20, 16), params={"dryness": "0.3"})
    return settled(scene, texture=False)


def test_the_first_look_is_the_scene(begun: ms.Scene):
    look = first_look(begun)
    assert look.params["dryness"] == 0.3 and look.thickness == begun.thickness and look.base_colour == begun.base_colour
    assert look.texture(begun) == ()
    assert isinstance(begun.camera, ms.Camera)
    scene = shown(begun, begun, look, begun.camera)
    np.testing.assert_array_equal(ms.render(scene, "draft").rgba, ms.render(begun, "draft").rgba)


def test_what_varies_by_an_image_has_no_value(tiny_bundle: Bundle):
    image = np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    scene = settled(ms.Scene(MESH, Material("tiny", tiny_bundle), params={"dryness": image}), texture=False)
    look = first_look(scene)
    assert "dryness" not in look.params
    assert shown(scene, scene, look, CAMERA).params["dryness"] is image


def test_each_value_reaches_the_scene(begun: ms.Scene):
    look = replace(
        first_look(begun), params={"dryness": 0.8}, thickness=0.2, base_colour=(0.1, 0.2, 0.3), sun=(0.0, 90.0)
    )
    scene = shown(begun, begun, look, CAMERA)
    assert scene.params["dryness"] == 0.8 and scene.thickness == 0.2 and scene.base_colour == (0.1, 0.2, 0.3)
    assert scene.camera is CAMERA and scene.environment is None
    assert len(scene.lights) == 1 and scene.lights[0] == pytest.approx((0, 1, 0))


def test_geometry_and_seed_ask_for_another_texture():
    begun = settled(ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0, params={"age": 4.0}), texture=False)
    look = first_look(begun)
    assert set(look.params) == {"age", "length"} and look.texture(begun) == (0, ("length", 2.0))
    for other in (replace(look, seed=5), replace(look, params={**look.params, "length": 3.0})):
        wanted = asked(begun, other)
        assert other.texture(begun) != look.texture(begun)
        assert wanted.seed == other.seed and wanted.params["length"] == other.params["length"]
    assert replace(look, params={**look.params, "age": 1.0}).texture(begun) == look.texture(begun)


def test_a_surface_material_has_little_to_set():
    begun = settled(ms.Scene(MESH, Material("dots", wearing.bundle()), scale=0.4), texture=False)
    look = first_look(begun)
    assert look.params == {} and look.thickness is None and look.texture(begun) == ()
    assert shown(begun, begun, look, CAMERA).thickness is None


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_sun_goes_around_the_axis_that_is_up(begun: ms.Scene, up):
    scene = replace(begun, up=up, camera=ms.Camera(ms.look_at((3.0, 2.0, 2.0), (0.0, 0.0, 0.0)), 0.6, 4, 4))
    axis = 1 if up == "y" else 2
    for azimuth in (-120.0, 0.0, 75.0):
        toward = np.array(toward_sun(scene, (azimuth, 30.0)))
        assert np.linalg.norm(toward) == pytest.approx(1) and toward[axis] == pytest.approx(0.5)
    back = np.delete(np.array(toward_sun(scene, (0.0, 0.0))), axis)
    eye = np.delete(ms.look_at((3.0, 2.0, 2.0), (0.0, 0.0, 0.0))[:3, 2], axis)
    np.testing.assert_allclose(back, eye / np.linalg.norm(eye), atol=1e-12)


def test_a_view_keeps_its_proportions():
    camera = ms.Camera(CAMERA.to_world, 0.6, 1200, 700)
    small = sized(camera, 128)
    assert (small.width, small.height) == (128, 75) and small.fov == camera.fov
    assert sized(ms.Camera(CAMERA.to_world, 0.6, 1, 4000), 128).width == 1


def test_the_command_makes_this_very_picture(begun: ms.Scene, tiny_bundle: Bundle, tmp_path: Path):
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    look = replace(first_look(begun), params={"dryness": 0.8}, sun=(30.0, 50.0), quality="draft", thickness=0.25)
    scene = shown(begun, begun, look, CAMERA)
    line = command(str(MESH), str(tmp_path / "tiny.npz"), scene, look, {}, 2)
    words = shlex.split(line)
    assert words[:2] == ["mesoshell", "render"]
    main([*words[1:], "--out", str(tmp_path / "a.png")])
    made = ms.render(scene, "draft", max_samples=2).rgba
    # numbers have six digits there, so a ray may meet another blade
    assert np.quantile(np.abs(read_exr(tmp_path / "a.exr") - made), 0.9) < 0.01 * made.max()


def test_looks_compare_by_value():
    assert Look(params={"a": 1.0}) == Look(params={"a": 1.0}) != Look(params={"a": 2.0})
