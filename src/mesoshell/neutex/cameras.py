"""A photograph's camera: a pinhole whose centre need not be the image's (NumPy).

Notation
M           camera to world, 4 × 4; the camera looks along −z, x to the right, y up
lens        (fx, fy, cx, cy), pixels
(x, y)      pixel coordinates, (0, 0) at the image's upper left corner; centres at + 0.5
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mesoshell.render.camera import Camera, centred, in_pixel, look_at


class Photo(NamedTuple):
    """Pose, lens and size of a photograph."""

    to_world: Float[np.ndarray, "4 4"]
    lens: tuple[float, float, float, float]
    width: int
    height: int


def photo_rays(photo: Photo, xy: Float[np.ndarray, "R 2"]) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
    """Origins and unit directions through image points."""
    return _through(photo.to_world, np.array(photo.lens), xy)


def rays_of(
    photos: Sequence[Photo], pixel: Int[np.ndarray, "R"]
) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
    """Rays through pixel centres; pixels are numbered through all photographs in turn, row by row."""
    ends = np.cumsum([p.width * p.height for p in photos])
    view = np.searchsorted(ends, pixel, "right")
    width, size = np.array([(p.width, p.width * p.height) for p in photos])[view].T
    y, x = np.divmod(pixel - (ends[view] - size), width)
    worlds, lenses = np.stack([p.to_world for p in photos]), np.array([p.lens for p in photos])
    return _through(worlds[view], lenses[view], np.stack([x, y], axis=1) + 0.5)


def _through(world: np.ndarray, lens: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """world, lens: one per point, or one for all."""
    right, down = ((xy - lens[..., 2:]) / lens[..., :2]).T
    local = np.stack([right, -down, -np.ones(len(xy))], axis=1)
    d = np.einsum("...ij,...j->...i", world[..., :3, :3], local)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.broadcast_to(world[..., :3, 3], d.shape), d


def pixels(photo: Photo, samples: int = 1, sample: int = 0) -> Float[np.ndarray, "R 2"]:
    """Image points of sample `sample` of `samples` in every pixel, row by row; the middles if there is one."""
    y, x = np.divmod(np.arange(photo.width * photo.height), photo.width)
    return np.stack([x, y], axis=1) + in_pixel(centred(samples, sample))


def shrunk(photo: Photo, factor: int) -> Photo:
    """The same camera for an image of means over factor × factor pixels; the rest at its ends is cut off."""
    fx, fy, cx, cy = (x / factor for x in photo.lens)
    return Photo(photo.to_world, (fx, fy, cx, cy), photo.width // factor, photo.height // factor)


def orbit(
    centre: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"], arm: Float[np.ndarray, "3"], turn: float
) -> np.ndarray:
    """Camera to world of a camera at centre + arm, rotated by `turn` about `up`, that looks at the centre."""
    from scipy.spatial.transform import Rotation

    eye = centre + Rotation.from_rotvec(turn * up).apply(arm)
    return look_at(tuple(eye), tuple(centre), tuple(up))


def up_of(photos: Sequence[Photo]) -> Float[np.ndarray, "3"] | None:
    """The mean of the photographs' upward directions; None if there is no such direction."""
    up = np.mean([p.to_world[:3, 1] for p in photos], axis=0)
    length = np.linalg.norm(up)
    return up / length if length > 1e-3 else None


def photo_of(camera: Camera) -> Photo:
    """A camera as a photograph's."""
    f = 1 / camera.spread
    return Photo(camera.to_world, (f, f, camera.width / 2, camera.height / 2), camera.width, camera.height)


def around(photos: Sequence[Photo], centre: Float[np.ndarray, "3"], frames: int, size: tuple[int, int]) -> list[Photo]:
    """Cameras on a circle about the mean of the photographs' upward directions, at their median height and distance, with the
    first one's angle of view across its shorter side. size: width and height. Raises ValueError if there is no such
    direction."""
    worlds = np.stack([p.to_world for p in photos])
    up = up_of(photos)
    if up is None:
        raise ValueError("the photographs have no common upward direction to go around")
    arms = worlds[:, :3, 3] - centre
    far, high = np.median(np.linalg.norm(arms, axis=1)), np.median(arms @ up / np.linalg.norm(arms, axis=1))
    sides = arms - np.outer(arms @ up, up)
    side = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    arm = far * (high * up + np.sqrt(max(1 - high**2, 0)) * side / max(np.linalg.norm(side), 1e-9))
    first, (width, height) = photos[0], size
    f = first.lens[1] / min(first.width, first.height) * min(width, height)
    lens = f, f, width / 2, height / 2
    return [Photo(orbit(centre, up, arm, 2 * np.pi * i / frames), lens, width, height) for i in range(frames)]
