"""Flicker is what a camera's motion does not explain: nothing where a painted surface is seen anew, much where it swims."""

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.film.flicker import FrameView, flicker, frame_view, reproject
from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.render.camera import pixel_grid, rays

CORNERS = np.array([[-2.0, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]])
FLOOR = check_mesh(CORNERS, np.array([[0, 2, 1], [0, 3, 2]]), CORNERS[:, [0, 2]][[[0, 2, 1], [0, 3, 2]]], "floor")
WALL = check_mesh(
    np.array([[-0.5, 0, 0.5], [0.5, 0, 0.5], [0.0, 1.5, 0.5]]),
    np.array([[0, 1, 2]]),
    np.array([[[0.0, 0], [1, 0], [0, 1]]]),
    "wall",
)


def camera(x: float, size: tuple[int, int] = (80, 60)) -> ms.Camera:
    return ms.Camera(ms.look_at((x, 2.5, 3.0), (0.0, 0.0, 0.0)), 0.7, *size)


def painted(camera: ms.Camera, offset: float = 0.0) -> np.ndarray:
    """A smooth pattern on the plane y = 0, and grey beyond the floor."""
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    x = o - d * (o[:, 1] / d[:, 1])[:, None]
    waves = 0.5 + 0.4 * np.sin(4 * (x[:, 0] + offset)) * np.cos(5 * x[:, 2])
    inside = (np.abs(x[:, [0, 2]]) < 2).all(axis=1) & (d[:, 1] < 0)
    return np.repeat(np.where(inside, waves, 0.5)[:, None], 3, axis=1).reshape(camera.height, camera.width, 3)


def test_what_motion_explains_is_no_flicker():
    a, b = camera(0.0), camera(0.4)
    before, now = frame_view(a, [(FLOOR, 0.0)]), frame_view(b, [(FLOOR, 0.0)])
    still = flicker(painted(a), painted(b), before, now)
    swims = flicker(painted(a, 0.2), painted(b), before, now)
    unmoved = flicker(painted(a), painted(b), before, before)
    assert still is not None and swims is not None and unmoved is not None
    assert still < 0.03 and swims > 4 * still and unmoved > 2 * still
    assert flicker(painted(a), painted(a), before, before) == pytest.approx(0.0, abs=1e-6)


def test_points_are_carried_to_where_they_were():
    """Oracle: the plane's points, projected by hand."""
    a, b = camera(-0.3), camera(0.5)
    points, valid = reproject(frame_view(a, [(FLOOR, 0.0)]), frame_view(b, [(FLOOR, 0.0)]))
    o, d = rays(b, pixel_grid(b, 1, 0))
    x = o - d * (o[:, 1] / d[:, 1])[:, None]
    clip = np.linalg.inv(a.to_world) @ np.concatenate([x, np.ones((len(x), 1))], axis=1).T
    at = np.stack([40 + clip[0] / -clip[2] / a.spread, 30 - clip[1] / -clip[2] / a.spread], axis=1)
    assert 0.5 < valid.mean() < 1
    np.testing.assert_allclose(points[valid], at[valid], atol=1e-6)
    outside = ((at < 0) | (at > [80, 60])).any(axis=1)
    assert outside.any() and not valid[outside].any()


def test_what_was_hidden_is_left_out():
    a, b = camera(-1.5), camera(1.5)
    before, now = (frame_view(c, [(FLOOR, 0.0)], (WALL,)) for c in (a, b))
    _, valid = reproject(before, now)
    _, bare = reproject(frame_view(a, [(FLOOR, 0.0)]), frame_view(b, [(FLOOR, 0.0)]))
    hidden = bare & ~valid
    assert 0.01 < hidden.mean() < 0.3


def test_a_surface_that_moved_is_followed():
    """Points of a floor that rises are found where they were."""
    a = camera(0.0)
    low, high = frame_view(a, [(FLOOR, 0.0)]), frame_view(a, [(FLOOR, 0.8)])
    points, valid = reproject(low, high)
    o, d = rays(a, pixel_grid(a, 1, 0))
    x = (o - d * ((o[:, 1] - 0.4) / d[:, 1])[:, None]) - [0, 0.4, 0]
    clip = np.linalg.inv(a.to_world) @ np.concatenate([x, np.ones((len(x), 1))], axis=1).T
    at = np.stack([40 + clip[0] / -clip[2] / a.spread, 30 - clip[1] / -clip[2] / a.spread], axis=1)
    assert valid.mean() > 0.4
    np.testing.assert_allclose(points[valid], at[valid], atol=1e-5)


def test_frames_that_share_nothing_have_none():
    a, away = camera(0.0), ms.Camera(ms.look_at((0.0, 2.5, 3.0), (0.0, 5.0, 6.0)), 0.7, 80, 60)
    assert flicker(painted(a), painted(away), frame_view(a, [(FLOOR, 0.0)]), frame_view(away, [(FLOOR, 0.0)])) is None


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_flicker_does_not_depend_on_the_unit(scale: float):
    def scaled(c: ms.Camera) -> FrameView:
        to_world = c.to_world.copy()
        to_world[:3, 3] *= scale
        vertices = (FLOOR.vertices * np.float32(scale)).astype(np.float32)
        mesh = Mesh(vertices, FLOOR.faces, FLOOR.uv, FLOOR.normals, ())
        return frame_view(ms.Camera(to_world, c.fov, c.width, c.height), [(mesh, 0.0)])

    a, b = camera(0.0), camera(0.4)
    plain = flicker(painted(a), painted(b), frame_view(a, [(FLOOR, 0.0)]), frame_view(b, [(FLOOR, 0.0)]))
    assert flicker(painted(a), painted(b), scaled(a), scaled(b)) == pytest.approx(plain, rel=0.02)
