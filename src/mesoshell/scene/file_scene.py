"""What a file of a scene says beside its meshes: a camera, suns, lamps, a sky, the axis that is up (no JAX)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import FARTHEST
from mesoshell.render.lamp import Lamp, fault_of
from mesoshell.render.light import Distant
from mesoshell.scene.dome import Dome


@dataclass(frozen=True)
class FileScene:
    """camera: its frame and vertical field of view, radians, or None; aspect: width over height that it was made for, or None;
    suns; lamps; notes: what the user should know, a line each; up: the axis, "y" or "z"; sky: a dome light, or None."""

    camera: tuple[Float[np.ndarray, "4 4"], float] | None
    aspect: float | None
    suns: tuple[Distant, ...]
    notes: tuple[str, ...]
    up: str = "y"
    sky: Dome | None = None
    lamps: tuple[Lamp, ...] = ()


def frame_of(to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The frame of a camera that looks along −z, without its node's scale: right, up, back, where it stands. Raises
    ValueError."""
    if not np.abs(to_world).max() <= FARTHEST:
        raise ValueError("a camera's transform holds a number that is not finite, or too large")
    back, up = _unit(to_world[:3, 2]), to_world[:3, 1]
    right = _unit(np.cross(up, back))
    out = np.eye(4)
    out[:3] = np.stack([right, np.cross(back, right), back, to_world[:3, 3]], axis=1)
    return out


def sun_of(to_world: Float[np.ndarray, "4 4"], irradiance: Float[np.ndarray, "3"]) -> Distant:
    """A light that shines along −z. Raises ValueError for a strength that none can have."""
    if irradiance.shape != (3,) or not ((irradiance >= 0) & (irradiance < 1e30)).all():
        raise ValueError(f"a sun has the irradiance {irradiance.tolist()}")
    return Distant(_unit(to_world[:3, 2]), irradiance)


def lamp_fault(lamp: Lamp) -> str:
    """Why a lamp cannot be; empty if it can."""
    return fault_of(lamp, FARTHEST, 1e30)


def _unit(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = float(np.linalg.norm(v))
    if not 0 < length < np.inf:
        raise ValueError("a camera or a light has no direction")
    return v / length
