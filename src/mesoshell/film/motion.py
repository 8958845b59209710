"""How a scene changes from frame to frame: its camera goes around, comes nearer, or it follows keys.

Notation
k           number of a frame, from 0
pivot       the point that the camera goes around, or comes near to: what it looks at; world
far         how many times as far away a dolly begins

A motion is asked for the fields of the scene that differ in frame k.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant

#: Most frames of a film.
MAX_FRAMES = 100_000


@dataclass(frozen=True)
class Motion:
    """count: frames; change: fields of the scene in frame k, `also` by number of the further material; shape: materials whose
    texture changes, so that each frame grows its own: 0 is the scene's own, 1 and on are those of `also`."""

    count: int
    change: Callable[[int], dict[str, Any]]
    shape: Collection[int] = ()


def orbit(
    camera: Camera, pivot: Float[np.ndarray, "3"], up: int, count: int, lights: Sequence[Distant | tuple] | None = None
) -> Motion:
    """Once around the axis through the pivot, at the camera's height; frame `count` would be frame 0. up: axis, 1 or 2;
    lights: of all frames; None: the scene's."""
    check_count("orbit", count)

    def change(k: int) -> dict[str, Any]:
        moved: dict[str, Any] = {"camera": rotate_about(camera, pivot, up, 2 * np.pi * k / count)}
        return moved if lights is None else moved | {"lights": tuple(lights)}

    return Motion(count, change)


def dolly(camera: Camera, pivot: Float[np.ndarray, "3"], far: float, count: int) -> Motion:
    """Along the line of sight to where the camera is, from `far` times its distance from the pivot, by the same factor each
    frame. Raises InputError for a `far` that is not positive and finite."""
    check_count("dolly", count)
    if not 0 < far < np.inf:
        raise InputError(Argument("far"), f"must be positive and finite, not {far:g}")

    def change(k: int) -> dict[str, Any]:
        share = 1.0 if count == 1 else k / (count - 1)
        to_world = camera.to_world.copy()
        to_world[:3, 3] += (camera.to_world[:3, 3] - pivot) * (far ** (1 - share) - 1)
        return {"camera": Camera(to_world, camera.fov, camera.width, camera.height)}

    return Motion(count, change)


def rotate_about(camera: Camera, pivot: Float[np.ndarray, "3"], up: int, angle: float) -> Camera:
    """The camera turned about the axis through the pivot, counter-clockwise seen from above. angle: radians."""
    rotation = np.eye(3)
    i, j = (up + 1) % 3, (up + 2) % 3
    rotation[[i, j], [i, j]] = np.cos(angle)
    rotation[i, j], rotation[j, i] = -np.sin(angle), np.sin(angle)
    to_world = camera.to_world.copy()
    to_world[:3, :3] = rotation @ camera.to_world[:3, :3]
    to_world[:3, 3] += (rotation - np.eye(3)) @ (camera.to_world[:3, 3] - pivot)
    return Camera(to_world, camera.fov, camera.width, camera.height)


def check_count(name: str, count: int) -> None:
    """Raise InputError unless a film can have so many frames."""
    if not 1 <= count <= MAX_FRAMES:
        raise InputError(Argument(name), f"must be from 1 to {MAX_FRAMES} frames, not {count}")
