"""Defaults of a scene: camera, lights, colours (NumPy only).

Notation
diagonal    of the mesh's bounding box, world
"""

import numpy as np
from jaxtyping import Float

from mesoshell.render.camera import Camera, look_at
from mesoshell.render.light import Distant

#: Width and height of the picture, pixels.
SIZE = (512, 512)
#: Irradiance of each light on a plane facing it.
IRRADIANCE = 12.0
#: Fill light, and the light from below, as shares of the key light.
FILL, BOUNCE = 0.3, 0.12
#: Light from behind where a camera goes around, as a share of the key light.
BACK = 0.6
#: Vertical field of view, degrees.
FIELD_OF_VIEW = 35.0


def default_camera(box: Float[np.ndarray, "2 3"], thickness: float, size: tuple[int, int], up: int) -> Camera:
    """A camera in front of a box with a layer about it: it shows all of it, from slightly above. up: axis, 1 or 2."""
    width, height = size
    fov = np.radians(FIELD_OF_VIEW)
    centre, radius = box.mean(axis=0), np.linalg.norm(box[1] - box[0]) / 2 + thickness
    narrow = 2 * np.arctan(np.tan(fov / 2) * min(1.0, width / height))
    front = np.array([0.55, 0.4, 0.75]) if up == 1 else np.array([0.55, -0.75, 0.4])
    eye = centre + front / np.linalg.norm(front) * radius / np.sin(narrow / 2) * 0.92
    return Camera(look_at(tuple(eye), tuple(centre), axis_of(up)), float(fov), width, height)


def axis_of(up: int) -> tuple[float, float, float]:
    """The unit vector upward. up: axis, 1 or 2."""
    return (0.0, 1.0, 0.0) if up == 1 else (0.0, 0.0, 1.0)


def default_lights(camera: Camera, up: int, irradiance: float) -> tuple[Distant, ...]:
    """A key light over the camera's left shoulder, a weak fill from its right, and a weaker bounce from below."""
    right, back, above = camera.to_world[:3, 0], camera.to_world[:3, 2], np.eye(3)[up]
    lights = (
        (1.1 * above - 0.7 * right + 0.5 * back, (1.0, 0.96, 0.9), 1.0),
        (0.4 * above + right + 0.6 * back, (0.8, 0.9, 1.0), FILL),
        (0.4 * back - above, (0.9, 0.95, 0.85), BOUNCE),
    )
    return tuple(Distant(v / np.linalg.norm(v), np.array(c) * share * irradiance) for v, c, share in lights)


def back_light(camera: Camera, up: int, irradiance: float) -> Distant:
    """A light from behind what the camera sees, for a camera that goes around it."""
    right, back = camera.to_world[:3, 0], camera.to_world[:3, 2]
    v = np.eye(3)[up] + 0.5 * right - 0.8 * back
    return Distant(v / np.linalg.norm(v), np.array([1.0, 0.97, 0.93]) * BACK * irradiance)
