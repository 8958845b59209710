"""A photograph's camera: a pinhole whose centre need not be the image's (NumPy; floor 4).

Alphabet
M           camera to world, 4 × 4; the camera looks along −z, x to the right, y up
lens        (fx, fy, cx, cy), pixels
(x, y)      pixel coordinates, (0, 0) at the image's upper left corner; centres at + 0.5
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Photo(NamedTuple):
    """Where a photograph was taken from, and how."""

    to_world: Float[np.ndarray, "4 4"]
    lens: tuple[float, float, float, float]
    width: int
    height: int


def photo_rays(photo: Photo, xy: Float[np.ndarray, "R 2"]) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
    """Origins and unit directions through image points."""
    fx, fy, cx, cy = photo.lens
    local = np.stack([(xy[:, 0] - cx) / fx, (cy - xy[:, 1]) / fy, -np.ones(len(xy))], axis=1)
    d = local @ photo.to_world[:3, :3].T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.broadcast_to(photo.to_world[:3, 3], d.shape), d


def rays_of(
    photos: Sequence[Photo], pixel: Int[np.ndarray, "R"]
) -> tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]]:
    """Rays through the middles of pixels that are counted through all photographs, one after the other, row by row."""
    ends = np.cumsum([p.width * p.height for p in photos])
    view = np.searchsorted(ends, pixel, "right")
    width, size = np.array([(p.width, p.width * p.height) for p in photos])[view].T
    y, x = np.divmod(pixel - (ends[view] - size), width)
    fx, fy, cx, cy = np.array([p.lens for p in photos])[view].T
    local = np.stack([(x + 0.5 - cx) / fx, (cy - y - 0.5) / fy, -np.ones(len(pixel))], axis=1)
    worlds = np.stack([p.to_world for p in photos])
    d = np.einsum("rij,rj->ri", worlds[view, :3, :3], local)
    return worlds[view, :3, 3], d / np.linalg.norm(d, axis=1, keepdims=True)


def pixel_centres(photo: Photo) -> Float[np.ndarray, "R 2"]:
    """Of all pixels, row by row."""
    y, x = np.divmod(np.arange(photo.width * photo.height), photo.width)
    return np.stack([x, y], axis=1) + 0.5


def shrunk(photo: Photo, factor: int) -> Photo:
    """The same camera of an image whose pixels are means of factor × factor; what is left over at the ends is cut off."""
    fx, fy, cx, cy = (x / factor for x in photo.lens)
    return Photo(photo.to_world, (fx, fy, cx, cy), photo.width // factor, photo.height // factor)


def orbit(
    centre: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"], arm: Float[np.ndarray, "3"], turn: float
) -> np.ndarray:
    """Camera to world of a camera at centre + arm turned by `turn` about `up`, that looks at the centre."""
    from scipy.spatial.transform import Rotation

    from mesoshell.render.camera import look_at

    eye = centre + Rotation.from_rotvec(turn * up).apply(arm)
    return look_at(tuple(eye), tuple(centre), tuple(up))
