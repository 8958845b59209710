"""Our frames and counts in Mitsuba's terms (NumPy only).

Notation
M           camera to world: ours looks along −z with x to the right, Mitsuba's along z with x to the left
"""

import math

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh, bounding_box
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import Lamp

#: From our latitude-longitude frame to Mitsuba's, by the axis that points up.
_SKY = {1: np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]), 2: np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])}


def near_clip(mesh: Mesh) -> float:
    """The distance up to which a sensor sees nothing: Mitsuba wants one; far less than a mesh is wide."""
    return float(min(1e-4, 1e-4 * np.linalg.norm(np.ptp(bounding_box(mesh).astype(np.float64), axis=0))))


def camera_pose(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """M of Mitsuba's sensor."""
    return camera.to_world @ np.diag([-1.0, 1, -1, 1])


def sky_pose(up: int) -> Float[np.ndarray, "4 4"]:
    """`to_world` of an `envmap` whose image is ours. up: 1 for y, 2 for z."""
    pose = np.eye(4)
    pose[:3, :3] = _SKY[up].T
    return pose


def spot_angles(lamp: Lamp) -> tuple[float, float]:
    """`beam_width` and `cutoff_angle` of a `spot`, degrees: the former below the latter."""
    begins, ends = np.degrees(lamp.cone)
    return float(min(begins, ends * (1 - 1e-4))), float(ends)


def fitting_grid(count: int) -> int:
    """The most samples, at most so many, that a multijittered sampler lays out in rows; it rounds other numbers up."""
    rows = math.isqrt(count)
    return rows * (count // rows)
