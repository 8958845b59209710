"""The sun about a mesh: its angles, and its handle under a pointer."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mesoshell as ms
from mesoshell.render.camera import rays
from mesoshell.viewer.sun import Drag, Sphere, dragged, sun_toward, toward_sun

SPHERE = Sphere(np.array([1.0, -2.0, 0.5]), 3.0)
EYE = np.add(SPHERE.centre, [0.0, 0.0, 12.0])


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_sun_goes_around_the_axis_that_is_up(up: str):
    to_world = ms.look_at((3.0, 2.0, 2.0), (0.0, 0.0, 0.0))
    axis = 1 if up == "y" else 2
    for azimuth in (-120.0, 0.0, 75.0):
        toward = np.array(toward_sun(to_world, np.eye(3)[axis], (azimuth, 30.0)))
        assert np.linalg.norm(toward) == pytest.approx(1) and toward[axis] == pytest.approx(0.5)
    back = np.delete(np.array(toward_sun(to_world, np.eye(3)[axis], (0.0, 0.0))), axis)
    eye = np.delete(to_world[:3, 2], axis)
    np.testing.assert_allclose(back, eye / np.linalg.norm(eye), atol=1e-12)


@given(
    st.integers(-179, 180),
    st.integers(-10, 89),
    st.sampled_from([(3.0, 2.0, 2.0), (0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (-4.0, 1e-3, 0.0)]),
    st.sampled_from([1, 2]),
)
def test_a_direction_has_the_angles_that_make_it(azimuth: int, elevation: int, eye: tuple[float, ...], axis: int):
    to_world, up = ms.look_at(eye, (0.0, 0.0, 0.0)), np.eye(3)[axis]
    toward = np.array(toward_sun(to_world, up, (float(azimuth), float(elevation))))
    found = sun_toward(to_world, up, toward)
    assert (found[0] - azimuth) % 360 == 0 and found[1] == elevation


def test_a_sun_stays_where_sliders_can_say():
    to_world, up = ms.look_at((3.0, 2.0, 2.0), (0.0, 0.0, 0.0)), np.eye(3)[1]
    assert sun_toward(to_world, up, up)[1] == 90 and sun_toward(to_world, up, -up)[1] == -10
    low = np.array(toward_sun(to_world, up, (70.0, -60.0)))
    assert sun_toward(to_world, up, low) == (70, -10)


@given(st.floats(-3, 3), st.floats(-3, 3), st.booleans())
def test_the_handle_is_under_the_pointer(x: float, y: float, far: bool):
    """Or, where the pointer is beside the sphere, next to it."""
    way = np.add(SPHERE.centre, [x, y, 0]) - EYE
    way = way / np.linalg.norm(way)
    toward, drag = dragged(EYE, way, SPHERE, Drag(far))
    assert np.linalg.norm(toward) == pytest.approx(1)
    to_handle = SPHERE.centre + SPHERE.radius * toward - EYE
    aside = np.linalg.norm(np.cross(to_handle, way))
    if drag.outside:
        others = np.random.default_rng(0).normal(size=(2000, 3))
        on_sphere = SPHERE.centre + SPHERE.radius * others / np.linalg.norm(others, axis=1, keepdims=True) - EYE
        assert aside <= np.linalg.norm(np.cross(on_sphere, way), axis=1).min() + 1e-9
    else:
        assert aside < 1e-6 and drag.far is far
        assert (toward @ to_handle > -1e-6) if far else (toward @ to_handle < 1e-6)


def test_a_pointer_goes_over_the_rim_to_the_other_side():
    def at(x: float, drag: Drag) -> tuple[np.ndarray, Drag]:
        way = np.array([x, 0.0, -1.0])
        return dragged(EYE, way / np.linalg.norm(way), SPHERE, drag)

    near, drag = at(0.1, Drag(far=False))
    beside, drag = at(0.4, drag)
    behind, drag = at(0.1, drag)
    assert near[2] > 0.5 and abs(beside[2]) < 0.5 and behind[2] < -0.5 and drag == Drag(far=True)
    again, _ = at(0.1, at(0.4, drag)[1])
    np.testing.assert_allclose(again, near)


@pytest.mark.parametrize("away", [0.0, 2.9, -3.1])
def test_from_within_and_with_the_sphere_behind(away: float):
    """There is one side, or none."""
    eye = np.add(SPHERE.centre, [0.0, 0.0, away])
    toward, drag = dragged(eye, np.array([0.0, 0.0, -1.0]), SPHERE, Drag(far=False))
    np.testing.assert_allclose(toward, [0, 0, -1], atol=1e-12)
    assert drag.outside is (away < -3)


def test_a_drag_of_the_handle_asks_for_one_picture():
    viser = pytest.importorskip("viser", reason="requires the extra viewer")
    import asyncio
    from types import SimpleNamespace

    from mesoshell.viewer.sun import Sun
    from tests.helpers.ports import free_port

    to_world, up = ms.look_at(tuple(EYE), tuple(SPHERE.centre)), np.eye(3)[1]
    camera = ms.Camera(to_world, 0.6, 400, 300)
    seen = SimpleNamespace(
        image_width=400, image_height=300, fov=0.6, position=EYE, wxyz=np.array([0.0, 1.0, 0.0, 0.0])
    )
    server, suns = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False), []
    try:
        sun: Any = None
        sun = Sun(server, to_world, up, SPHERE, "", lambda _: suns.append(sun.sun))
        sun.on.value = True
        assert suns == [(-40.0, 45.0)] and sun._handle.visible
        places = [(0.5, 0.5), (0.55, 0.4), (0.5, 0.4)]
        for phase, place in zip(("start", "update", "end"), places, strict=True):
            event = SimpleNamespace(client=SimpleNamespace(camera=seen), client_id=3, phase=phase, end_screen_pos=place)
            asyncio.run(sun._dragged(event))
            _, (way,) = rays(camera, np.array([place]) * [400, 300])
            aside = np.cross(sun._handle.position - EYE, way)
            assert np.linalg.norm(aside) < 0.02 * SPHERE.radius  # in whole degrees
        assert len(suns) == 4 and suns[-1] == sun.sun and not sun._drags
        sun._azimuth.value = 90.0
        np.testing.assert_allclose(
            sun._handle.position, SPHERE.centre + SPHERE.radius * np.array(toward_sun(to_world, up, sun.sun)), atol=1e-6
        )
    finally:
        server.stop()
