"""Lamps light a plain floor as they do by hand: in both engines, and in a scene that is written for Mitsuba."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mesoshell as ms
import mesoshell.pathtracer
from mesoshell.film.shoot import plan_motion
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.render.lamp import as_distant
from mesoshell.scene.lod import describe_twin
from mesoshell.scene.settle import settle
from mesoshell.scene.setup import describe_shell
from mesoshell.scene.unpack import read_scene_file
from mesoshell.viewer.look import first_look, scene_of_look
from mesoshell.viewer.work import Workshop
from tests.helpers.path_traced import box, constant

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

RGB, ALBEDO = np.array([30.0, 20.0, 10.0]), 0.4
POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_euler("xyz", [0.15, 0.1, 0.4]).as_matrix() * (0.3, 0.2, 0.25)
POSE[:3, 3] = 1.1, 0.3, 2.0
ROUND = POSE.copy()
ROUND[:3, :3] = 0.2 * np.eye(3)
LAMPS = {
    "point": ms.Lamp("point", POSE, RGB),
    "spot": ms.Lamp("spot", POSE, RGB, (0.1, 0.6)),
    "sphere": ms.Lamp("sphere", ROUND, RGB),
    "rectangle": ms.Lamp("rectangle", POSE, RGB),
    "disk": ms.Lamp("disk", POSE, RGB),
}


@pytest.fixture
def clear(tiny_bundle: Bundle, tmp_path: Path) -> ms.Material:
    """A material that nothing is seen of."""
    write_bundle(tmp_path / "clear.npz", constant(tiny_bundle, 1e-6, 1e-6))
    return ms.load_material(tmp_path / "clear.npz")


def floor(material: ms.Material, **more: Any) -> ms.Scene:
    """The unit square, of which the middle is seen, at the height of 0."""
    given: dict[str, Any] = {"thickness": 0.01, "size": (2, 2), "base_colour": (ALBEDO,) * 3, "up": "z"}
    given["camera"] = (0.5, 0.5, 3.0, 0.5, 0.501, 0.0, 0.1)
    return ms.Scene(box(), material, **(given | more))


@pytest.mark.parametrize("kind", sorted(LAMPS))
def test_a_floor_is_lit_as_by_hand(kind: str, clear: ms.Material, tmp_path: Path):
    scene = floor(clear, lamps=[LAMPS[kind]])
    direction, irradiance = as_distant(LAMPS[kind], np.array([[0.5, 0.5, 0.0]]))
    wanted = ALBEDO / np.pi * irradiance * direction[2]
    ours = ms.render(scene, "draft")
    xy = np.random.default_rng(1).random((20_000, 2))
    mean = as_distant(LAMPS[kind], xy @ np.eye(2, 3))  # over the floor
    on_mean = ALBEDO / np.pi * mean.irradiance * mean.direction[2]
    np.testing.assert_allclose(ours.rgba[..., :3].mean(axis=(0, 1)), on_mean, rtol=0.02)
    assert any("a lamp is near what is lit" in note for note in ours.notes)
    traced = ms.render(scene, "normal", engine="mitsuba", spp=256, max_depth=2)
    np.testing.assert_allclose(traced.rgba[..., :3].mean(axis=(0, 1)), wanted, rtol=0.03)
    assert not any("lamp" in note for note in traced.notes)
    effects = ms.explain(scene, engine="mitsuba")
    assert effects.area_light.on == (kind not in ("point", "spot"))
    path = ms.write_scene(scene, tmp_path / "made")
    written = np.array(mi.render(ms.mitsuba.load_file(path), spp=256))
    np.testing.assert_allclose(written[..., :3].mean(axis=(0, 1)), wanted, rtol=0.03)


@pytest.mark.parametrize("kind", [pytest.param("sphere", marks=pytest.mark.slow), "rectangle"])
def test_a_camera_sees_through_lamps(kind: str, clear: ms.Material, tmp_path: Path):
    """One hangs between the camera and the floor, and shines down; around it the sky is seen. So it is in a scene of
    Mitsuba's that it is written to; and a rectangle turned to the camera is not seen either."""
    pose = np.diag([0.3, 0.3, 0.3, 1.0])
    pose[:3, 3] = 0.5, 0.5, 1.5
    lamp = ms.Lamp(kind, pose, np.full(3, 9.0))  # type: ignore[arg-type]
    scene = floor(clear, lamps=[lamp], size=(8, 8), camera=(0.5, 0.5, 3.0, 0.5, 0.501, 0.0, 60.0))
    scene = replace(scene, environment=np.full((2, 4, 3), 0.1, np.float32))
    seen = ms.render(scene, "normal", engine="mitsuba", spp=64, max_depth=2).rgba
    assert seen[0, 0, 0] == pytest.approx(0.1) and seen[..., :3].max() < 3  # the lamp's radiance is 9
    middle = seen[3:5, 3:5, 0].mean()
    assert middle > 0.15  # lit by it, and nothing is black in between
    turned = ms.Lamp(kind, pose @ np.diag([1.0, -1, -1, 1]), np.full(3, 9.0))  # type: ignore[arg-type]
    away = ms.render(replace(scene, lamps=[turned]), "normal", engine="mitsuba", spp=64, max_depth=2).rgba
    assert away[..., :3].max() < 3
    clear_of = ms.render(replace(scene, transparent=True), "normal", engine="mitsuba", spp=16, max_depth=2).rgba[..., 3]
    assert clear_of[0, 0] == 0 and clear_of[3:5, 3:5].min() == 1  # the floor behind the lamp
    if kind == "sphere":
        np.testing.assert_allclose(away, seen, atol=0.1)
    written = ms.mitsuba.load_file(ms.write_scene(scene, tmp_path / "made", quality=ms.Quality(max_depth=2)))
    np.testing.assert_allclose(np.array(mi.render(written, spp=64)), seen, atol=0.1)
    (tmp_path / "shown.xml").write_text(
        (tmp_path / "made" / "scene.xml").read_text().replace('"hide_lamps" value="true"', '"hide_lamps" value="false"')
    )
    (tmp_path / "shown.xml").replace(tmp_path / "made" / "shown.xml")
    shown = np.array(mi.render(ms.mitsuba.load_file(tmp_path / "made" / "shown.xml"), spp=64))
    assert shown[3:5, 3:5, 0].mean() == pytest.approx(9.0 if kind == "sphere" else 0.0, abs=0.1)


@pytest.mark.parametrize("aside", [0.0, 3.0])
def test_a_lamp_stands_in_no_lights_way(aside: float, clear: ms.Material):
    """A sun behind a large lamp that shines up, away from the floor: it gives the floor nothing, and takes nothing away."""
    pose = np.diag([2.0, -2.0, -1.0, 1.0])
    pose[:3, 3] = 0.5 + aside, 0.5, 1.0
    lamp = ms.Lamp("rectangle", pose, np.full(3, 1.0))
    sun = ms.Distant(np.array([0.0, 0.0, 1.0]), np.full(3, 5.0))
    scene = floor(clear, lamps=[lamp], lights=[sun], camera=(0.5, 0.5, 0.9, 0.5, 0.501, 0.0, 0.1))
    seen = ms.render(scene, "normal", engine="mitsuba", spp=64, max_depth=4).rgba
    np.testing.assert_allclose(seen[..., :3], ALBEDO / np.pi * 5, rtol=1e-3)
    assert "no other surfaces" in ms.explain(scene, engine="mitsuba").object_shadow.why


def test_two_lamps_one_behind_the_other_both_light(clear: ms.Material):
    """The sum of each alone, by samples of lights and of directions."""
    poses = [np.diag([0.5, 0.5, 1.0, 1.0]), np.diag([0.6, 0.6, 1.0, 1.0])]
    poses[0][:3, 3], poses[1][:3, 3] = (0.5, 0.5, 1.0), (0.5, 0.5, 2.0)
    both = [ms.Lamp("rectangle", pose, np.full(3, 2.0)) for pose in poses]
    seen = [
        ms.render(floor(clear, lamps=lamps), "normal", engine="mitsuba", spp=1024, max_depth=2).rgba[..., :3].mean()
        for lamps in (both, both[:1], both[1:])
    ]
    assert seen[0] == pytest.approx(seen[1] + seen[2], rel=0.02) and min(seen[1:]) > 0.05


def test_where_there_are_lamps_there_are_no_default_lights(clear: ms.Material):
    assert len(settle(floor(clear)).lights) == 3
    still = settle(floor(clear, lamps=[LAMPS["point"]]))
    assert not still.lights and len(still.lamps) == 1
    assert (
        "1 distant" in ms.explain(still).direct_light.why
        and "1 point" in ms.explain(still, engine="mitsuba").direct_light.why
    )


def test_a_lamp_far_away_is_a_distant_light_without_a_note(clear: ms.Material):
    far = LAMPS["point"]._replace(pose=np.array([[1.0, 0, 0, 40], [0, 1, 0, 30], [0, 0, 1, 90], [0, 0, 0, 1]]))
    lit = ms.render(floor(clear, lamps=[far]), "draft")
    assert not any("lamp" in note for note in lit.notes)
    sun = as_distant(far, np.array([[0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(lit.rgba, ms.render(floor(clear, lights=[sun]), "draft").rgba, rtol=2e-3)


def test_a_files_lamps_give_way_to_what_is_given(clear: ms.Material):
    file = Path(__file__).parents[1] / "data" / "blender.glb"
    own = read_scene_file(file).lamps
    assert [lamp.kind for lamp in own] == ["point"]
    scene = replace(floor(clear), mesh=file, camera=None, up=None)
    for given, suns, lamps in (
        ({}, 1, list(own)),
        ({"suns": False}, 3, []),
        ({"lights": [(0.0, 1.0, 0.0)]}, 1, []),
        ({"lamps": [LAMPS["disk"]]}, 0, [LAMPS["disk"]]),
    ):
        still = settle(replace(scene, **given))
        assert isinstance(still.mesh, Mesh) and len(still.lights) == suns
        assert [lamp.kind for lamp in still.lamps] == [lamp.kind for lamp in lamps]


def test_what_is_no_lamp_is_one_line(clear: ms.Material):
    with pytest.raises(ms.InputError, match=r"^lamps: a point takes a strength of three numbers from 0 to 1e.*$"):
        ms.explain(floor(clear, lamps=[LAMPS["point"]._replace(strength=-RGB)]))


def test_films_twins_and_the_viewer_keep_them(clear: ms.Material):
    scene = floor(clear, lamps=[LAMPS["disk"]])
    still = settle(scene)
    assert "lights" not in plan_motion(scene, orbit=4)(still).change(1)  # no further light behind: it is lit
    assert "lights" in plan_motion(floor(clear), orbit=4)(settle(floor(clear))).change(1)
    assert describe_twin(describe_shell(scene)).lamps[0].kind == "disk"
    look = first_look(scene)
    assert isinstance(still.camera, ms.Camera)
    shown = scene_of_look(scene, still, look, still.camera, True)
    assert shown.lamps[0].kind == "disk" and not shown.lights
    sunny = scene_of_look(scene, still, replace(look, sun=(0.0, 45.0)), still.camera, True)
    assert not sunny.lamps and len(sunny.lights) == 1


def test_which_engine_says_that_lamps_are_near(clear: ms.Material):
    scene = floor(clear, lamps=[LAMPS["disk"]])
    for engine, said in (("jax", True), ("mitsuba", False)):
        work = Workshop(scene, lambda view: None, lambda text: None, lambda share: None, engine)
        work.close()
        assert any("a lamp is near" in note for note in work.notes) == said


def test_lamps_that_hardly_light_it_cost_engine_jax_nothing(clear: ms.Material):
    far = np.eye(4)
    far[:3, 3] = 900.0, 0.0, 900.0
    lamps = [LAMPS["point"], *(ms.Lamp("point", far, RGB) for _ in range(20))]
    assert "1 distant" in ms.explain(floor(clear, lamps=lamps)).direct_light.why
    assert "21 point" in ms.explain(floor(clear, lamps=lamps), engine="mitsuba").direct_light.why


def test_lists_are_arrays_too(clear: ms.Material):
    given = ms.Lamp("point", POSE.tolist(), RGB.tolist())  # type: ignore[arg-type]
    for use in (lambda x: describe_shell(floor(clear, lamps=x)).lamps, lambda x: settle(floor(clear, lamps=x)).lamps):
        ((_, pose, strength, _),) = use([given])
        np.testing.assert_array_equal(pose, POSE)
        np.testing.assert_array_equal(strength, RGB)
