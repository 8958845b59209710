"""A scene to render: a mesh under a shell, its materials, a camera and lights.

Notation
α           appearance parameters in the order of the bundle, each normalised to [0, 1] by its range
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant, Environment
from mesoshell.shell.geometry.extrude import EARTH, Shell
from mesoshell.shell.material.loader import DeviceMaterial


@dataclass(frozen=True, eq=False)
class Medium:
    """What grows in some of a shell's prisms, up to those of the next medium. prism, face: the first of them, and of the mesh's
    faces under them; alpha: normalised parameters; maps: those that vary, each (H, W) over the UV square, normalised too;
    patches_per_uv: texture patches along one unit of the mesh's UV."""

    device_material: DeviceMaterial
    alpha: Float[np.ndarray, "A"]
    maps: dict[str, Float[np.ndarray, "_ _"]]
    patches_per_uv: float
    prism: int
    face: int


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene. mesh, shell: of all that is grown, joined. device_material, alpha, maps, patches_per_uv: of the first medium, as
    in `Medium`; others: the rest, by their prisms. base_colour: diffuse albedo under the shell, and of `objects` without a
    colour. holdout:
    whether the picture is transparent where it would show objects.
    """

    mesh: Mesh
    shell: Shell
    device_material: DeviceMaterial
    camera: Camera
    lights: tuple[Distant, ...]
    environment: Environment | None = None
    alpha: Float[np.ndarray, "A"] = field(default_factory=lambda: np.zeros(0, np.float32))
    maps: dict[str, Float[np.ndarray, "_ _"]] = field(default_factory=dict)
    patches_per_uv: float = 1.0
    others: tuple[Medium, ...] = ()
    base_colour: tuple[float, float, float] = EARTH
    objects: tuple[Mesh, ...] = ()
    transparent: bool = True
    holdout: bool = False

    @property
    def media(self) -> tuple[Medium, ...]:
        """All of them, in the order of their prisms."""
        return Medium(self.device_material, self.alpha, self.maps, self.patches_per_uv, 0, 0), *self.others
