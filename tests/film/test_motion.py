"""Cameras go around, and come nearer, as they are told; keys give what they say and nothing beyond."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.film.frame import Shot
from mesoshell.film.keys import follow, read_keys
from mesoshell.film.motion import dolly, orbit
from mesoshell.io.bundle import Bundle
from mesoshell.scene.materials import Material
from tests.helpers import growing, wearing

EYE, PIVOT = (1.0, 2.0, 4.0), np.array([0.5, -0.3, 0.2])
CAMERA = ms.Camera(ms.look_at(EYE, tuple(PIVOT)), 0.6, 40, 30)
MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CAMERAS = st.lists(st.floats(-5, 5), min_size=3, max_size=3)


@pytest.fixture
def scene(tiny_bundle: Bundle) -> ms.Scene:
    return ms.Scene(MESH, Material("tiny", tiny_bundle), params={"dryness": 0.25})


@pytest.mark.parametrize("up", [1, 2])
def test_an_orbit_keeps_height_and_distance_and_closes(up: int):
    moves = orbit(CAMERA, PIVOT, up, 8)
    cameras = [moves.change(k)["camera"] for k in range(9)]
    np.testing.assert_array_equal(cameras[0].to_world, CAMERA.to_world)
    np.testing.assert_allclose(cameras[8].to_world, CAMERA.to_world, atol=1e-12)
    for camera in cameras:
        m = camera.to_world
        np.testing.assert_allclose(m[:3, :3] @ m[:3, :3].T, np.eye(3), atol=1e-12)
        assert m[up, 3] == pytest.approx(EYE[up])
        np.testing.assert_allclose(np.linalg.norm(m[:3, 3] - PIVOT), np.linalg.norm(EYE - PIVOT))
        np.testing.assert_allclose(m[:3, 2], (m[:3, 3] - PIVOT) / np.linalg.norm(EYE - PIVOT), atol=1e-12)
    steps = [np.linalg.norm(b.to_world[:3, 3] - a.to_world[:3, 3]) for a, b in pairwise(cameras)]
    np.testing.assert_allclose(steps, steps[0])
    # counter-clockwise seen from above
    a, b = (np.delete(c.to_world[:3, 3] - PIVOT, up) for c in cameras[:2])
    assert (1 if up == 2 else -1) * (a[0] * b[1] - a[1] * b[0]) > 0


def test_a_dolly_ends_where_the_camera_is_and_slows_down():
    moves = dolly(CAMERA, PIVOT, 8.0, 4)
    places = np.array([moves.change(k)["camera"].to_world[:3, 3] for k in range(4)])
    np.testing.assert_allclose(np.linalg.norm(places - PIVOT, axis=1) / np.linalg.norm(EYE - PIVOT), [8, 4, 2, 1])
    np.testing.assert_array_equal(places[3], EYE)
    assert dolly(CAMERA, PIVOT, 8.0, 1).change(0)["camera"].to_world[0, 3] == pytest.approx(EYE[0])


@pytest.mark.parametrize("far", [0.0, -1.0, np.inf, np.nan])
def test_a_dolly_begins_somewhere(far: float):
    with pytest.raises(InputError, match=r"^far: must be positive and finite"):
        dolly(CAMERA, PIVOT, far, 4)


@pytest.mark.parametrize("count", [0, -3, 100_001])
def test_a_film_has_some_frames(count: int):
    with pytest.raises(InputError, match=f"must be from 1 to 100000 frames, not {count}"):
        orbit(CAMERA, PIVOT, 1, count)


def test_keys_are_met_and_stay_at_both_ends(scene: ms.Scene):
    a, b = [1, 2, 3, 0, 0, 0, 30], [2, 2, 3, 0, 0, 1, 40]
    keys = [
        {"frame": 2, "camera": a},
        {"frame": 5, "camera": b, "params": {"dryness": 0.8}},
        {"frame": 7, "thickness": 0.1},
    ]
    moves = follow(keys, scene)
    assert moves.count == 8 and not moves.shape
    for k, camera in ((0, a), (2, a), (5, b), (7, b)):
        change = moves.change(k)
        np.testing.assert_allclose(change["camera"], camera, atol=1e-12)
        assert change["params"] == {"dryness": 0.8} and change["thickness"] == 0.1
    assert follow([{"frame": 3}], scene).change(1) == {}


def test_keys_of_further_materials(tiny_bundle: Bundle, scene: ms.Scene):
    """By their material's name or their own, which counts more."""
    moss, grown = Material("moss", tiny_bundle), Material("lawn", growing.bundle())
    scene = replace(
        scene, also=[ms.Grown(MESH, moss), ms.Grown(MESH, moss, name="stone"), ms.Grown(MESH, grown, name="a:hill")]
    )
    keys = [
        {"frame": 0, "params": {"stone:dryness": 0.5, "moss:dryness": 0.1, "dryness": 0.9, "moss:thickness": 0.2}},
        {"frame": 2, "params": {"a:hill:length": 3.0, "moss:dryness": 0.3}},
    ]
    moves = follow(keys, scene)
    assert list(moves.shape) == [3]
    assert moves.change(1) == {
        "params": {"dryness": 0.9},
        "also": {
            0: {"thickness": 0.2, "params": {"dryness": 0.2}},
            1: {"thickness": 0.2, "params": {"dryness": 0.5}},
            2: {"params": {"length": 3.0}},
        },
    }
    shown = Shot(scene, ms.Quality(), "jax").scene(moves.change(2))
    assert [x.params for x in (shown, *shown.also)] == [
        {"dryness": 0.9},
        {"dryness": pytest.approx(0.3)},
        {"dryness": 0.5},
        {"length": 3.0},
    ]
    for params, fault in [
        ({"rock:dryness": 1}, "rock:dryness: rock is not among the further materials: moss, stone, a:hill"),
        ({"stone:dryness": 9}, "stone: dryness=9 lies outside"),
        ({"stone:thickness": 0}, "stone:thickness must be a positive number"),
        ({"stone:wet": 1}, "wet"),
    ]:
        with pytest.raises(InputError, match=f"^keys: .*{fault}"):
            follow([{"frame": 0, "params": params}], scene)
    cloth = replace(scene, also=[ms.Grown(MESH, Material("dots", wearing.bundle()), name="cloth")])
    with pytest.raises(InputError, match=r"^keys: cloth:age: dots is a surface material: it has no parameters"):
        follow([{"frame": 0, "params": {"cloth:age": 1}}], cloth)


@given(st.lists(st.floats(0, 1), min_size=2, max_size=6), st.data())
def test_between_keys_nothing_lies_beyond_them(values: list[float], data: st.DataObject):
    gaps = data.draw(st.lists(st.integers(1, 9), min_size=len(values), max_size=len(values)))
    frames = np.cumsum(gaps) - gaps[0]
    keys = [{"frame": int(f), "camera": [v, 0, 3, 0, 0, 0, 30]} for f, v in zip(frames, values, strict=True)]
    moves = follow(keys, ms.Scene(MESH, Material("dots", wearing.bundle())))
    for i in range(len(values) - 1):
        low, high = sorted(values[i : i + 2])
        between = [moves.change(int(k))["camera"][0] for k in range(frames[i], frames[i + 1] + 1)]
        assert low - 1e-12 <= min(between) and max(between) <= high + 1e-12
        assert (np.diff(between) * np.sign(values[i + 1] - values[i]) >= -1e-12).all()


@pytest.mark.parametrize(
    ("keys", "fault"),
    [
        ([], "must hold at least one key"),
        ([{"frame": 1}, {"frame": 1}], "key 1: frame must be a whole number above 1, not 1"),
        ([{"frame": -1}], "key 0: frame must be a whole number above -1, not -1"),
        ([{"frame": 0.5}], "key 0: frame must be a whole number above -1, not 0.5"),
        ([{"frame": True}], "key 0: frame must be"),
        ([{"camera": [0] * 7}], "key 0: frame must be a whole number above -1, not None"),
        ([{"frame": 0, "camera": [0, 1, 2]}], "key 0: camera must be 7 numbers"),
        ([{"frame": 0, "camera": [0, 1, 2, 0, 0, 0, float("nan")]}], "key 0: camera must be 7 numbers"),
        ([{"frame": 0, "eye": [0, 1, 2]}], "key 0: unknown field 'eye': there are frame, camera, params, thickness"),
        ([{"frame": 0, "params": {"age": "old"}}], "key 0: params must give numbers by name"),
        ([{"frame": 0, "thickness": 0}], "key 0: thickness must be a positive number"),
        ([3], "key 0: must be an object"),
        ([{"frame": 0, "camera": [0, 1, 2, 0, 0, 0, 180]}], "key 0: camera must have its eye apart from its target"),
        ([{"frame": 0, "camera": [0, 1, 2, 0, 1, 2, 30]}], "key 0: camera must have its eye apart from its target"),
        ([{"frame": 0, "camera": [0, 1, 1e30, 0, 1, 2, 30]}], "key 0: camera holds a number beyond 1e"),
        ([{"frame": 0, "params": {"dryness": 10**400}}], "key 0: params must give numbers by name"),
    ],
)
def test_what_is_no_key_is_said(keys: list, fault: str, scene: ms.Scene, tmp_path: Path):
    with pytest.raises(InputError, match=f"^keys: {fault}"):
        follow(keys, scene)
    path = tmp_path / "keys.json"
    path.write_text(json.dumps({"keys": keys}))
    with pytest.raises(InputError, match=f"^{path}: {fault}"):
        read_keys(path)


@pytest.mark.parametrize("text", ["", "[]", '{"keys": 3}', '{"frames": []}', "{", '{"keys":' * 100_000])
def test_what_is_no_file_of_keys_is_said(text: str, tmp_path: Path):
    path = tmp_path / "keys.json"
    path.write_text(text)
    with pytest.raises(InputError, match=f"^{path}: "):
        read_keys(path)


def test_parameters_are_the_materials(scene: ms.Scene):
    for params, fault in (
        ({"dryest": 0.1}, "no parameter 'dryest'; did you mean dryness"),
        ({"dryness": 7.0}, "dryness=7 lies outside"),
    ):
        with pytest.raises(InputError, match=f"^keys: {fault}"):
            follow([{"frame": 0, "params": params}], scene)
    dots = ms.Scene(MESH, Material("dots", wearing.bundle()))
    for key in ({"params": {"age": 0.1}}, {"thickness": 0.1}):
        with pytest.raises(InputError, match=r"^keys: dots is a surface material"):
            follow([{"frame": 0, **key}], dots)
