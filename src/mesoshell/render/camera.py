"""Pinhole cameras: rays, and the cone of a pixel.

Notation
M           camera to world, 4 × 4; the camera looks along −z, x to the right, y up (OpenGL and Blender)
fov         full vertical field of view, radians
(x, y)      pixel coordinates, (0, 0) at the image's upper left corner; centres at + 0.5
spread      tangent of the angle one pixel subtends at the centre of the image: pixel width per unit distance
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.render.sequence import PLANE


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. Raises InputError for a size, a field of view or a pose that no camera has."""

    to_world: Float[np.ndarray, "4 4"]
    fov: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not 0 < self.fov < np.pi:
            raise InputError(Argument("fov"), f"must be between 0 and π radians, not {self.fov}")
        if self.width < 1 or self.height < 1:
            raise InputError(Argument("width"), f"{self.width} x {self.height} has no pixels")
        if not np.isfinite(self.to_world).all():
            raise InputError(Argument("to_world"), "holds NaN or infinite values")
        if not np.linalg.det(self.to_world[:3, :3]):
            raise InputError(Argument("to_world"), "has axes that lie in a plane: no camera has it")

    @property
    def spread(self) -> float:
        return 2 * np.tan(self.fov / 2) / self.height


def look_at(eye: tuple, target: tuple, up: tuple = (0.0, 1.0, 0.0)) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world matrix of a camera at `eye` that looks at `target` with `up` upward in the image. Raises InputError if
    eye and target are one point, or any of them is not finite."""
    eye_, target_, up_ = (np.asarray(v, np.float64) for v in (eye, target, up))
    back = eye_ - target_
    length = np.linalg.norm(back)
    if not np.isfinite(length):
        raise InputError(Argument("eye"), "eye or target is not finite")
    if not 0 < np.linalg.norm(up_) < np.inf:
        raise InputError(Argument("up"), f"must be a direction, not {tuple(up)}")
    if not length > 0:
        raise InputError(Argument("eye"), "eye and target are the same point")
    back /= length
    if np.linalg.norm(np.cross(up_, back)) < 1e-9 * np.linalg.norm(up_):  # straight up or down: any other up will do
        up_ = np.array([0.0, 0.0, -1.0]) if abs(back[1]) > 0.5 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up_, back)
    right /= np.linalg.norm(right)
    m = np.eye(4)
    m[:3, :4] = np.stack([right, np.cross(back, right), back, eye_], axis=1)
    return m


def pixel_radius(spread: float) -> float:
    """Radius, at distance 1, of the cone of a box pixel of width `spread`: the disc of the box's variance, w²/12 an axis
    (Barron et al. 2021)."""
    return spread * 2 / 12**0.5


def rays(camera: Camera, xy: Float[np.ndarray, "R 2"]) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
    """Origins and unit directions through the image points `xy`, in float64, (R, 3) each."""
    x = (xy[:, 0] - camera.width / 2) * camera.spread
    y = (camera.height / 2 - xy[:, 1]) * camera.spread
    local = np.stack([x, y, -np.ones_like(x)], axis=1)
    directions = local @ camera.to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(camera.to_world[:3, 3], directions.shape), directions


def pixel_grid(camera: Camera, samples: int, sample: int) -> Float[np.ndarray, "R 2"]:
    """Image points of sample `sample` of `samples` in every pixel, row by row: centres for one, else an R2 lattice."""
    y, x = np.divmod(np.arange(camera.height * camera.width), camera.width)
    return np.stack([x, y], axis=1) + in_pixel(centred(samples, sample))


def in_pixel(steps: float) -> Float[np.ndarray, "2"]:
    """A place in a pixel, [0, 1)²: so many steps of an R2 lattice from its middle. Consecutive steps cover it evenly."""
    return (0.5 + steps * PLANE) % 1.0


def centred(samples: int, sample: int) -> float:
    """Steps of sample `sample` of `samples`: as many before the middle as behind it, so their mean is the pixel's centre."""
    return sample - (samples - 1) / 2


def outward(sample: int) -> float:
    """Steps of a sample of a sequence that may end anywhere: 0, 1, -1, 2, -2, ... An odd number of them is centred."""
    return (sample + 1) // 2 * (1.0 if sample % 2 else -1.0)
