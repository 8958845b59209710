"""The finest and the coarsest texture levels that a scene's cameras can see.

Notation
ṙ           deviation of a pixel's cone at distance 1: half its radius
d           least distance from a camera to a prism, world
s           greatest world length of a patch on a prism, over directions of (u, v)
w           width of the filter, `Quality.footprint`, pixels
needed      s / (2 w ṙ d) texels a patch: there a texel is as wide as the footprint's ±1 deviation, and finer levels are not
            read
magnified   s̄ / (2 ṙ d n), with the mean length s̄ of a patch, at n columns of a grid a patch, and a distance d that a tenth of
            the pixels that see a surface lie below: a column over a pixel's ±1 deviation
coarsest    2 ṙ D n / s, with the greatest distance D and the least s, at n texels a patch: a pixel's ±1 deviation in texels

Indirect views have longer paths, so their footprints are wider. (Magnification by a lens or a concave mirror is ignored.)
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import trimesh
from jaxtyping import Float

from mesoshell.pathtracer.render_context import RADIUS
from mesoshell.shell.geometry.extrude import Shell

#: Positions in the picture where cones are measured, as shares of its sides: the narrowest are in the corners.
_PLACES = (0.0, 0.5, 1.0)
#: The same for distances.
_MANY = (np.arange(24) + 0.5) / 24
#: Cameras whose rays start from about one point.
PINHOLES = ("PerspectiveCamera", "ThinLensCamera")


def texels_needed(sensors: list[mi.Sensor], shells: list[Shell], most: int, footprint: float) -> int:
    """Texels a patch, `most` or a half, a quarter, ... of it, that the nearest view of any shell needs. footprint: in pixels, 0
    without a filter."""
    if footprint == 0 or any(s.class_name() not in PINHOLES for s in sensors):
        return most
    needed = max((_needed(sensor, shell) / footprint for sensor in sensors for shell in shells), default=float(most))
    while most > 1 and needed <= most / 2:
        most //= 2
    return most


def coarsest(sensors: list[mi.Sensor], shells: list[Shell], texels: list[float]) -> float:
    """The widest footprint of a camera on any shell, in texels; texels: per patch of each shell."""
    if any(s.class_name() not in PINHOLES for s in sensors):
        return np.inf
    views = ((sensor, shell, n) for sensor in sensors for shell, n in zip(shells, texels, strict=True))
    return max((_widest(sensor, shell) * n for sensor, shell, n in views), default=0.0)


def magnified(scene: mi.Scene, shells: list[Shell], columns: list[float]) -> float:
    """How large columns are, of any shell, where a camera sees a surface from near; columns: per patch of each shell."""
    if any(s.class_name() not in PINHOLES for s in scene.sensors()):
        return np.inf
    widest = max((_mean_patch(shell) / n for shell, n in zip(shells, columns, strict=True)), default=0.0)
    return max((widest / (2 * _spread(s) * _near(scene, s)) for s in scene.sensors()), default=0.0)


def eye_of(sensor: mi.Sensor) -> Float[np.ndarray, "3"]:
    """Where a camera stands, world."""
    return np.array(sensor.world_transform().matrix)[:3, 3].ravel()


def _needed(sensor: mi.Sensor, shell: Shell) -> float:
    base = shell.base.astype(np.float64)[shell.faces]
    eyes = np.broadcast_to(eye_of(sensor), (len(base), 3))
    away = np.linalg.norm(trimesh.triangles.closest_point(base, eyes) - eyes, axis=1)
    away = away - np.linalg.norm(shell.offset[shell.faces], axis=-1).max(axis=1)
    if (away <= 0).any():
        return np.inf
    return float((_patch_length(shell, base) / (2 * _spread(sensor) * away)).max())


def _widest(sensor: mi.Sensor, shell: Shell) -> float:
    """Patches."""
    base = shell.base.astype(np.float64)[shell.faces]
    far = np.linalg.norm(base + shell.offset[shell.faces] - eye_of(sensor), axis=-1).max()
    length = _patch_length(shell, base, -2)
    return float(2 * _spread(sensor, np.max) * far / length[length > 0].min(initial=np.inf))


def _near(scene: mi.Scene, sensor: mi.Sensor) -> float:
    """The distance that a tenth of the rays that meet a surface do not reach; infinite if none meets one."""
    places = np.stack(np.meshgrid(_MANY, _MANY)).reshape(2, -1)
    wavelength: Any = dr.full(mi.Float, 0.5, places.shape[1])
    rays, _ = sensor.sample_ray(_time(sensor, places.shape[1]), wavelength, mi.Point2f(places), mi.Point2f(0.5))
    far = np.array(scene.ray_intersect_preliminary(rays).t)
    return float(np.quantile(far[np.isfinite(far)], 0.1)) if np.isfinite(far).any() else np.inf


def _mean_patch(shell: Shell) -> float:
    """World length of a patch, the mean over the shell."""
    uv = shell.uv.astype(np.float64)
    patches = np.abs(np.linalg.det(np.stack([uv[:, 0] - uv[:, 2], uv[:, 1] - uv[:, 2]], axis=-1))).sum() / 2
    area = trimesh.triangles.area(shell.base.astype(np.float64)[shell.faces]).sum()
    return float(np.sqrt(area / patches)) if patches > 0 else 0.0


def _patch_length(shell: Shell, base: np.ndarray, order: int = 2) -> np.ndarray:
    """s of each prism: the greatest singular value of ∂P/∂(u, v), or the least (order −2); the larger one of base and top."""
    uv = shell.uv.astype(np.float64)
    across = np.stack([uv[:, 0] - uv[:, 2], uv[:, 1] - uv[:, 2]], axis=-1)
    lengths = []
    for corners in (base, base + shell.offset[shell.faces]):
        edges = np.stack([corners[:, 0] - corners[:, 2], corners[:, 1] - corners[:, 2]], axis=-1)
        flat = np.abs(np.linalg.det(across)) < 1e-30
        lengths.append(
            np.linalg.norm(edges @ np.linalg.inv(np.where(flat[:, None, None], np.eye(2), across)), order, (1, 2))
        )
    return np.maximum(*lengths)


def _spread(sensor: mi.Sensor, which: Callable = np.min) -> float:
    """ṙ, the least over the picture by default (`which`)."""
    places = np.stack(np.meshgrid(_PLACES, _PLACES)).reshape(2, -1)
    count = places.shape[1]
    wavelength: Any = dr.full(mi.Float, 0.5, count)
    rays, _ = sensor.sample_ray_differential(_time(sensor, count), wavelength, mi.Point2f(places), mi.Point2f(0.5))
    return float(which(np.array(dr.norm(rays.d_x - rays.d)))) * RADIUS / 2


def _time(sensor: mi.Sensor, count: int) -> Any:
    """When a camera's shutter opens, for so many rays."""
    return dr.full(mi.Float, float(sensor.shutter_open()), count)
