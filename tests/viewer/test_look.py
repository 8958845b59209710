"""What is set is what is shown, and what the command line says."""

import shlex
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_exr
from mesoshell.scene.growth import surface_part
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from mesoshell.viewer.look import (
    Painting,
    Sky,
    command,
    describe_look,
    first_look,
    scene_of_look,
    with_size,
    with_textures_of,
)
from tests.helpers import growing, wearing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CAMERA = ms.Camera(ms.look_at((1.0, 2.0, 9.0), (0.0, 0.0, 0.0)), 0.6, 20, 16)


@pytest.fixture(autouse=True)
def _no_cache_at_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def begun(tiny_bundle: Bundle) -> ms.Scene:
    scene = ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, size=(20, 16), params={"dryness": "0.3"})
    return settle(scene, texture=False)


def test_the_first_look_is_the_scene(begun: ms.Scene):
    look = first_look(begun)
    assert look.params["dryness"] == 0.3 and look.thickness == begun.thickness and look.base_colour == begun.base_colour
    assert look.texture(begun) == ()
    assert isinstance(begun.camera, ms.Camera)
    scene = scene_of_look(begun, begun, look, begun.camera, True)
    np.testing.assert_array_equal(ms.render(scene, "draft").rgba, ms.render(begun, "draft").rgba)


def test_what_varies_by_an_image_has_no_value(tiny_bundle: Bundle):
    image = np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    scene = settle(ms.Scene(MESH, Material("tiny", tiny_bundle), params={"dryness": image}), texture=False)
    look = first_look(scene)
    assert "dryness" not in look.params
    np.testing.assert_array_equal(scene_of_look(scene, scene, look, CAMERA, False).params["dryness"], image)


def test_each_value_reaches_the_scene(begun: ms.Scene):
    look = replace(
        first_look(begun),
        params={"dryness": 0.8},
        thickness=0.2,
        scale=0.5,
        base_colour=(0.1, 0.2, 0.3),
        sun=(0.0, 90.0),
    )
    assert look.texture(begun) == ()
    scene = scene_of_look(begun, begun, look, CAMERA, True)
    assert scene.params["dryness"] == 0.8 and (scene.thickness, scene.scale) == (0.2, 0.5)
    assert scene.base_colour == (0.1, 0.2, 0.3)
    assert scene.camera is CAMERA and scene.environment is None
    assert len(scene.lights) == 1 and scene.lights[0] == pytest.approx((0, 1, 0))


def test_geometry_and_seed_ask_for_another_texture():
    begun = settle(ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0, params={"age": 4.0}), texture=False)
    look = first_look(begun)
    assert set(look.params) == {"age", "length"} and look.texture(begun) == (0, None, 1.0, ("length", 2.0))
    longer = {**look.params, "length": 3.0}
    others = {"seed": 5}, {"params": longer}, {"latent": (5, 0.5)}, {"scale": 2.0}
    for other in (replace(look, **fields) for fields in others):
        wanted = with_textures_of(begun, begun, other, [None])
        assert other.texture(begun) != look.texture(begun)
        assert (wanted.seed, wanted.latent, wanted.scale) == (other.seed, other.latent, other.scale)
        assert wanted.params["length"] == other.params["length"]
    assert replace(look, params={**look.params, "age": 1.0}).texture(begun) == look.texture(begun)


def test_patches_that_are_grown_stay_as_wide_until_others_are():
    begun = settle(ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0), texture=False)
    wider = replace(first_look(begun), scale=2.0)
    assert scene_of_look(begun, begun, wider, CAMERA, True).scale == 1.0
    wanted = with_textures_of(begun, begun, wider, [None])
    assert (
        scene_of_look(begun, wanted, wider, CAMERA, True).scale
        == describe_look(begun, wider, CAMERA, True).scale
        == 2.0
    )


def test_the_command_says_how_far_the_latent_is(tmp_path: Path):
    write_bundle(tmp_path / "it.npz", growing.bundle())
    material = ms.load_material(tmp_path / "it.npz")
    given = ms.Scene(MESH, material, scale=1.0, also=(ms.Grown(MESH, material, scale=1.0, name="other"),))
    begun = settle(given, texture=False)
    own, other = (2**32 - 1, 0.25), (4, 0.75)
    look = first_look(begun)
    look = replace(look, latent=own, also=(replace(look.also[0], latent=other),))
    words = command(given, replace(begun, camera=CAMERA), look, "jax", 1)
    assert "--latent 4294967295 0.25" in words and "--param other:latent=4,0.75" in words


def test_a_panel_goes_toward_another_seed():
    """Where the share is 0 it does not."""
    pytest.importorskip("viser", reason="requires the extra viewer")
    from mesoshell.viewer.panel import Panel

    gui = MagicMock()
    gui.add_number = gui.add_slider = lambda label, *given, **_: MagicMock(value=given[-1], label=label)
    scene = settle(ms.Scene(MESH, Material("grown", growing.bundle()), latent=(3, 0.25)), texture=False)
    panel = Panel(gui, scene, first_look(scene), "Material", lambda _: None)
    assert panel.look()["latent"] == (3, 0.25)
    assert panel._share is not None
    panel._share.value = 0.0
    assert panel.look()["latent"] is None
    lawn = settle(ms.Scene(MESH, ms.load_material("lawn")), texture=False)
    assert Panel(gui, lawn, first_look(lawn), "Material", lambda _: None)._share is None


def test_what_is_painted_takes_a_number_s_place(tmp_path: Path, begun: ms.Scene):
    image = np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    painting = Painting(image)
    look = replace(first_look(begun), painted={"dryness": painting})
    scene = scene_of_look(begun, begun, look, CAMERA, False)
    np.testing.assert_array_equal(scene.params["dryness"], image)
    assert look == replace(look) and look != replace(look, painted={"dryness": Painting(image)})
    assert "--param dryness=dryness.exr" in command(replace(begun, mesh=MESH, lights=()), scene, look, "jax", 2)


def test_painted_geometry_asks_for_another_texture():
    begun = settle(ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0), texture=False)
    look, painting = first_look(begun), Painting(np.full((4, 4), 0.5, np.float32))
    painted = replace(look, painted={"length": painting})
    assert painted.texture(begun) != look.texture(begun) and painted.texture(begun) == replace(painted).texture(begun)
    assert replace(look, painted={"length": Painting(painting.image)}).texture(begun) != painted.texture(begun)
    assert replace(look, painted={"age": painting}).texture(begun) == look.texture(begun)
    np.testing.assert_array_equal(with_textures_of(begun, begun, painted, [None]).params["length"], painting.image)


def test_a_surface_material_has_little_to_set():
    begun = settle(ms.Scene(MESH, Material("dots", wearing.bundle()), scale=0.4), texture=False)
    look = first_look(begun)
    assert look.params == {} and look.thickness is None and look.scale == 0.4 and look.texture(begun) == ()
    scene = scene_of_look(begun, begun, replace(look, scale=0.7), CAMERA, False)
    assert scene.thickness is None and scene.scale == 0.7
    period = first_look(settle(ms.Scene(MESH, begun.material), texture=False)).scale
    assert period is not None and period == surface_part(ms.Scene(MESH, begun.material)).period


def test_a_view_keeps_its_proportions():
    camera = ms.Camera(CAMERA.to_world, 0.6, 1200, 700)
    small = with_size(camera, 128)
    assert (small.width, small.height) == (128, 75) and small.fov == camera.fov
    assert with_size(ms.Camera(CAMERA.to_world, 0.6, 1, 4000), 128).width == 1


@pytest.mark.parametrize("lit", [True, False])
def test_a_sky_takes_the_place_of_the_scenes_lights(begun: ms.Scene, lit: bool):
    """With a sun, both light it."""
    own = np.ones((2, 4, 3), np.float32)
    scene, sky = replace(begun, environment=own), Sky("studio.exr", np.full((4, 8, 3), 0.5, np.float32))
    look = first_look(scene)
    under = scene_of_look(scene, scene, replace(look, sky=sky), CAMERA, lit)
    assert under.environment is sky.radiance and under.lights == ()
    both = scene_of_look(scene, scene, replace(look, sky=sky, sun=(0.0, 90.0)), CAMERA, lit)
    assert both.environment is sky.radiance and both.lights[0] == pytest.approx((0, 1, 0))
    assert scene_of_look(scene, scene, look, CAMERA, lit).environment is own
    given = replace(scene, mesh=MESH, lights=[(0.0, 1.0, 0.0)], environment="old.exr")
    line = command(given, under, replace(look, sky=sky), "jax", 2)
    assert "--environment studio.exr" in line and "--light" not in line and "old.exr" not in line
    assert look != replace(look, sky=sky) and replace(look, sky=sky) != replace(
        look, sky=Sky("studio.exr", sky.radiance)
    )


@pytest.mark.parametrize(
    ("lit", "sun"),
    [
        (True, None),
        (False, (30.0, 50.0)),
        pytest.param(True, (30.0, 50.0), marks=pytest.mark.slow),
        pytest.param(False, None, marks=pytest.mark.slow),
    ],
)
def test_the_command_makes_this_very_picture(tiny_bundle: Bundle, tmp_path: Path, sun, lit: bool):
    """Its numbers have six digits, so a ray may meet another blade."""
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    lights = [(0.4, 0.8, 0.1), (-1.0, 0.1, 0.0)] if lit else []
    material = ms.load_material(tmp_path / "tiny.npz")
    given = ms.Scene(MESH, material, scale=0.4, lights=lights, irradiance=5.0, objects=[MESH], transparent=True)
    begun = settle(given, texture=False)
    look = replace(first_look(begun), params={"dryness": 0.8}, sun=sun, quality="draft", thickness=0.25)
    look = replace(look, changes={"samples": 6, "filtering": False, "spacing": "length", "skip": 0.01} if lit else {})
    away = ms.Camera(ms.look_at((-6.0, 1.0, -7.0), (0.0, 0.0, 0.0)), 0.6, 20, 16)  # not from where it began
    scene = scene_of_look(begun, begun, look, away, lit)
    words = shlex.split(command(given, scene, look, "jax", 2))
    assert words[:2] == ["mesoshell", "render"]
    main([*words[1:], "--out", str(tmp_path / "a.png")])
    made = ms.render(scene, look.settings, max_samples=2).rgba
    away_from = np.abs(read_exr(tmp_path / "a.exr") - made)
    assert np.median(away_from) < 1e-3 * made.max() and np.quantile(away_from, 0.95) < 0.02 * made.max()


def test_under_a_sky_a_files_suns_are_left_out(tiny_bundle: Bundle):
    given = ms.Scene(MESH.with_name("blender.glb"), Material("tiny", tiny_bundle))
    begun = settle(given, texture=False)
    assert isinstance(begun.camera, ms.Camera)
    look = first_look(begun)
    for sky in (None, Sky("sky.exr", np.ones((2, 4, 3), np.float32))):
        own = replace(look, sky=sky)
        words = command(given, scene_of_look(begun, begun, own, begun.camera, True), own, "jax", 1).split()
        assert ("--no-suns" in words) is (sky is not None) and "--light" not in words


def test_the_command_has_the_camera_far_from_the_origin_and_angles_whole(tiny_bundle: Bundle, tmp_path: Path):
    """Of a mesh in millimetres, somewhere: the view, read back, is within a hundredth of a pixel; a slider near its end is."""
    away = wearing.moved(wearing.ball(900.0), 3e4, 2e4, -5e4)
    path = wearing.write_obj(tmp_path / "far.obj", away)
    write_bundle(tmp_path / "it.npz", growing.bundle())
    scene = ms.Scene(path, ms.load_material(tmp_path / "it.npz"), scale=300.0)
    begun = settle(scene, texture=False)
    eye = np.add([3e4, 2e4, -5e4], [2500.123, 1333.7, 1700.9])
    camera = ms.Camera(ms.look_at(tuple(eye), (3e4 + 10.0, 2e4, -5e4)), 0.6, 384, 384)
    name, parameter = next(iter(begun.material.parameters.items()))
    high = np.nextafter(parameter.range[1], -np.inf)
    look = replace(first_look(begun), params={**first_look(begun).params, name: float(high)})
    words = shlex.split(command(scene, replace(begun, camera=camera), look, "jax", 1))
    numbers = [float(x) for x in words[words.index("--camera") + 1 :][:7]]
    found = ms.look_at(tuple(numbers[:3]), tuple(numbers[3:6]))
    assert np.abs(found[:3, :3] - camera.to_world[:3, :3]).max() < 0.01 * camera.spread
    assert np.abs(found[:3, 3] - eye).max() < 1e-6 * 900
    said = next(word for word in words if word.startswith(f"{name}="))
    assert float(said.partition("=")[2]) == high
