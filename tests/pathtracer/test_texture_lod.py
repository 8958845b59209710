"""How fine a texture has to be: of a plane seen from straight above, by hand."""

import numpy as np
import pytest

from mesoshell.geometry.mesh import check_mesh
from mesoshell.pathtracer.texture_lod import magnified, texels_needed
from mesoshell.shell.geometry.extrude import Shell, extrude

import mitsuba as mi  # isort: skip

ACROSS, THICKNESS, PIXELS = 4.0, 0.25, 64


def plane(scale: float) -> Shell:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * ACROSS / 2
    uv = np.array([[[0.0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    return extrude(check_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), uv, "plane"), THICKNESS, scale)


def camera(away: float, kind: str = "perspective") -> mi.Sensor:
    view = mi.ScalarTransform4f().look_at([0.3, 0.1, away], [0.3, 0.1, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS}
    made = {"type": kind, "to_world": view, "film": film}
    return mi.load_dict(made | ({"fov": 40} if kind == "perspective" else {}))


def least(away: float, scale: float) -> float:
    """Texels a patch, from the angle between neighbouring pixels' rays in a corner, where it is smallest."""
    edge = np.tan(np.radians(20))
    rays = np.array([[edge, edge, 1.0], [edge * (1 - 2 / PIXELS), edge, 1.0]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    deviation = np.linalg.norm(rays[1] - rays[0]) / np.sqrt(12) * (away - THICKNESS)
    return scale / (2 * deviation)


@pytest.mark.parametrize("away", [0.5, 1.0, 3.0, 9.0, 200.0])
@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_the_least_power_of_two_that_is_enough(away, scale) -> None:
    found = texels_needed([camera(away)], [plane(scale)], 256, 1.0)
    needed = np.clip(least(away, scale), 0.5, 256)
    assert needed <= found * 1.03  # pixels are as wide as their middles are apart, and the corner's middle lies inside
    assert found == 1 or found / 2 < needed * 1.03


def test_narrower_footprints_need_finer_texels() -> None:
    found = [texels_needed([camera(9.0)], [plane(1.0)], 256, footprint) for footprint in (1.0, 0.5, 0.0)]
    assert found == [found[0], 2 * found[0], 256] and found[1] < 256


def test_the_nearest_of_cameras_and_shells_counts() -> None:
    near, far = camera(1.0), camera(9.0)
    assert texels_needed([near, far], [plane(1.0)], 256, 1.0) == texels_needed([near], [plane(1.0)], 256, 1.0)
    assert texels_needed([far], [plane(1.0), plane(0.5)], 256, 1.0) == texels_needed([far], [plane(1.0)], 256, 1.0)


def test_all_texels_where_rays_come_from_elsewhere_or_a_camera_is_in_the_shell() -> None:
    assert texels_needed([camera(9.0, "orthographic")], [plane(1.0)], 64, 1.0) == 64
    assert texels_needed([camera(0.1)], [plane(1.0)], 64, 1.0) == 64
    assert texels_needed([], [plane(1.0)], 64, 1.0) == 64


def ground(away: float, kind: str = "perspective") -> mi.Scene:
    """The plane itself, and a camera above."""
    square = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(ACROSS / 2)}
    return mi.load_dict({"type": "scene", "camera": camera(away, kind), "plane": square})


@pytest.mark.parametrize("away", [0.5, 3.0])
@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_how_wide_a_column_is_seen(away, scale) -> None:
    """Straight from above, by hand, at a distance that is a little more than the least; of the coarsest of shells."""
    seen = magnified(ground(away), [plane(scale)], [32.0])
    assert 0.9 < seen / (least(away + THICKNESS, scale) / 32) < 1.02
    assert magnified(ground(away), [plane(scale)], [64.0]) == pytest.approx(seen / 2)
    both = magnified(ground(away), [plane(scale), plane(scale)], [64.0, 32.0])
    assert both == pytest.approx(seen)


def test_a_column_that_no_camera_sees_and_one_that_may_be_anywhere() -> None:
    assert magnified(ground(3.0, "orthographic"), [plane(1.0)], [32.0]) == np.inf
    away = mi.load_dict({"type": "scene", "camera": camera(3.0)})
    assert magnified(away, [plane(1.0)], [32.0]) == 0
