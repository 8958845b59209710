"""A sun about a mesh: a checkbox, sliders, and a handle that is dragged over a sphere around the mesh.

Notation
sun         azimuth and elevation, degrees; azimuth from where the first camera stands, counter-clockwise seen from above
toward      unit vector toward the sun
far         whether the handle is on the sphere's other side, seen from a camera; a pointer that leaves the sphere and comes
            back goes over to that side
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.render.camera import rays
from mesoshell.viewer.browser import camera_of

AZIMUTHS = (-180.0, 180.0)
ELEVATIONS = (-10.0, 90.0)
#: Where a sun stands at first.
FIRST = (-40.0, 45.0)
#: Radius of the handle, as a share of the sphere's.
HANDLE = 0.05
COLOUR = (255, 190, 40)


class Sphere(NamedTuple):
    """About a mesh: the handle of its sun lies on it."""

    centre: Float[np.ndarray, "3"]
    radius: float


@dataclass(frozen=True)
class Drag:
    """far: as above; outside: whether the pointer is beside the sphere."""

    far: bool
    outside: bool = False


class Sun:
    """Controls in the folder of a server's page that is open, and a handle in its picture. to_world: of the first camera;
    hint: of the checkbox; changed: called when the sun is another."""

    def __init__(
        self,
        server: Any,
        to_world: Float[np.ndarray, "4 4"],
        up: Float[np.ndarray, "3"],
        sphere: Sphere,
        hint: str,
        changed: Callable[[Any], None],
    ):
        gui, (azimuth, elevation) = server.gui, FIRST
        self._to_world, self._up, self._sphere, self._changed = to_world, up, sphere, changed
        self._drags: dict[int, Drag] = {}
        self._setting = False
        self.on = gui.add_checkbox("sun", False, hint=f"{hint}; its handle in the picture can be dragged")
        self._azimuth = gui.add_slider("azimuth", *AZIMUTHS, 1.0, azimuth, hint="degrees from the first camera")
        self._elevation = gui.add_slider("elevation", *ELEVATIONS, 1.0, elevation, hint="degrees above the horizon")
        radius = HANDLE * sphere.radius
        self._handle = server.scene.add_icosphere("/sun", radius, COLOUR, cast_shadow=False, visible=False)
        self._place()
        self._handle.on_drag("left")(self._dragged)
        for control in (self.on, self._azimuth, self._elevation):
            control.on_update(self._set)

    @property
    def sun(self) -> tuple[float, float] | None:
        """Where it is; None while it is off."""
        return self._angles() if self.on.value else None

    def _angles(self) -> tuple[float, float]:
        return float(self._azimuth.value), float(self._elevation.value)

    def _set(self, _: Any) -> None:
        if not self._setting:
            self._place()
            self._changed(None)

    def _place(self) -> None:
        self._handle.position = self._position()
        self._handle.visible = self.on.value

    def _position(self) -> Float[np.ndarray, "3"]:
        toward = toward_sun(self._to_world, self._up, self._angles())
        return self._sphere.centre + self._sphere.radius * np.array(toward)

    async def _dragged(self, event: Any) -> None:
        """A pointer that drags the handle; in order, since it is awaited."""
        camera, client = camera_of(event.client.camera), event.client_id
        if camera is None:
            return
        (eye,), (way,) = rays(camera, np.array([event.end_screen_pos]) * [camera.width, camera.height])
        if event.phase == "start" or client not in self._drags:
            position = self._position()
            self._drags[client] = Drag(bool((position - self._sphere.centre) @ (position - eye) > 0))
        toward, self._drags[client] = dragged(eye, way, self._sphere, self._drags[client])
        if event.phase == "end":
            del self._drags[client]
        self._setting = True  # both, then one picture
        self._azimuth.value, self._elevation.value = sun_toward(self._to_world, self._up, toward)
        self._setting = False
        self._set(None)


def dragged(
    eye: Float[np.ndarray, "3"], way: Float[np.ndarray, "3"], sphere: Sphere, drag: Drag
) -> tuple[Float[np.ndarray, "3"], Drag]:
    """Where a ray from the eye, of unit direction, meets the sphere, as a unit vector from its centre; where it passes, the
    place next to it."""
    from_centre = (eye - sphere.centre) / sphere.radius
    nearest = -float(from_centre @ way)
    aside = from_centre + nearest * way
    step = math.sqrt(max(1 - float(aside @ aside), 0.0))  # half of the chord
    if step == 0 or nearest + step <= 0:  # it passes, or the sphere lies behind
        place = from_centre + max(nearest, 0.0) * way
        return place / np.linalg.norm(place), replace(drag, outside=True)
    far = drag.far != drag.outside
    place = from_centre + (nearest + (step if far or nearest < step else -step)) * way  # from within there is one side
    return place / np.linalg.norm(place), Drag(far)


def toward_sun(
    to_world: Float[np.ndarray, "4 4"], up: Float[np.ndarray, "3"], sun: tuple[float, float]
) -> tuple[float, float, float]:
    """Direction toward a sun, seen from a camera's side."""
    back, left = _level(to_world, up)
    azimuth, elevation = (math.radians(x) for x in sun)
    level = math.cos(azimuth) * back + math.sin(azimuth) * left
    x, y, z = math.cos(elevation) * level + math.sin(elevation) * up
    return float(x), float(y), float(z)


def sun_toward(
    to_world: Float[np.ndarray, "4 4"], up: Float[np.ndarray, "3"], toward: Float[np.ndarray, "3"]
) -> tuple[float, float]:
    """The sun in a direction, in whole degrees: the inverse of `toward_sun`, no lower than the lowest elevation."""
    back, left = _level(to_world, up)
    azimuth = math.degrees(math.atan2(toward @ left, toward @ back))
    elevation = math.degrees(math.asin(np.clip(toward @ up, -1, 1)))
    return float(round(azimuth)), float(round(max(elevation, ELEVATIONS[0])))


def _level(
    to_world: Float[np.ndarray, "4 4"], up: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Horizontal unit vectors: toward the camera, and a quarter turn on."""
    back = to_world[:3, 2] - (to_world[:3, 2] @ up) * up
    if not np.linalg.norm(back) > 1e-9:  # it looks straight down
        back = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    back = back / np.linalg.norm(back)
    return back, np.cross(up, back)
