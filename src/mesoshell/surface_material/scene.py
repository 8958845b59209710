"""A mesh with a surface material to render, the same for all engines."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mesoshell.geometry.mesh import Mesh, bounding_box
from mesoshell.io.surface import SurfaceBundle
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import Lamp
from mesoshell.render.light import Distant, Environment


@dataclass(frozen=True, eq=False)
class SurfaceDescription:
    """A mesh, its lights and surroundings. period: world length of one period of the texture; base_colour: diffuse albedo of
    further objects without a colour; lamps: of engine mitsuba (`scene/setup.with_distant_lamps`)."""

    mesh: Mesh
    period: float
    camera: Camera
    lights: tuple[Distant, ...]
    environment: Environment | None
    base_colour: tuple[float, float, float]
    objects: tuple[Mesh, ...]
    transparent: bool
    lamps: tuple[Lamp, ...] = ()


class SurfacePart(NamedTuple):
    """A mesh with a surface material in a scene of shells. period: world length."""

    mesh: Mesh
    period: float
    material: SurfaceBundle


def default_period(mesh: Mesh) -> float:
    """Default world length of a period: 2/25 of the bounding box's diagonal."""
    low, high = bounding_box(mesh)
    return float(np.linalg.norm(high - low)) * 2 / 25
