"""A scene, as far as it decides which effects it calls for (NumPy only; no JAX). Each engine fills it from its own scene."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TwinFacts:
    """Of a surface material that was distilled from the shell. finest: the least footprint (standard deviation) that the camera
    can have on the shell, patches; errors: its error by footprint (io/twin); misfit: why it is not this shell's, or nothing."""

    finest: float
    errors: tuple[tuple[float, float], ...]
    misfit: str


@dataclass(frozen=True)
class Facts:
    """A scene, as far as the decisions rest on it.

    shells, surfaces: how many meshes carry a shell, and a surface material; objects: other surfaces. distant, point, area:
    emitters without extent far away, without extent nearby, and those that a ray can meet; environment: there is one, and seen:
    it is seen behind the scene. convex: no part of a mesh can shadow another of it. enclosed: mean share of the directions
    from a surface that meet a surface again, of the mesh or object where it is largest; 0 only where nothing can. low:
    light may come from below the horizon of a shell's face. ground: albedo of what is under the shells, 1 where it does more
    than reflect diffusely. coarsest: the largest footprint in texels that a camera can have on
    the shells (one standard deviation to either side); rows: of their height features. inside: a camera may be in a shell.
    varying: names of parameters of appearance that vary over the surface; shaped: so does geometry. passable: rays may pass
    the surface materials.
    """

    shells: int = 0
    surfaces: int = 0
    objects: int = 0
    distant: int = 0
    point: int = 0
    area: int = 0
    environment: bool = False
    seen: bool = False
    convex: bool = False
    enclosed: float = 0.0
    low: bool = False
    ground: float = 0.0
    coarsest: float = 0.0
    rows: int = 0
    inside: bool = False
    varying: tuple[str, ...] = ()
    shaped: bool = False
    passable: bool = False
    twin: TwinFacts | None = None

    @property
    def alone(self) -> bool:
        """There is one shell, on a convex mesh: what has left it does not meet it again."""
        return self.convex and self.shells == 1 and not self.surfaces

    @property
    def lit(self) -> bool:
        return bool(self.distant or self.point or self.area or self.environment)
