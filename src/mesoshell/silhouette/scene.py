"""What there is to render of a mesh that wears a surface material, in no engine's own terms."""

from dataclasses import dataclass

from mesoshell.geometry.mesh import Mesh
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant, Environment


@dataclass(frozen=True, eq=False)
class SurfaceDescription:
    """A mesh, and what it is seen by. period: world length of one period of the texture; base_colour: of further objects,
    diffuse."""

    mesh: Mesh
    period: float
    camera: Camera
    lights: tuple[Distant, ...]
    environment: Environment | None
    base_colour: tuple[float, float, float]
    objects: tuple[Mesh, ...]
    transparent: bool
