"""Facts of a scene that decide its effects (NumPy only; no JAX). Each engine fills them in from its own scene."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TwinFacts:
    """A surface material distilled from the shell. finest: the least footprint (standard deviation) that the camera can
    have on the shell, patches; errors: its error by footprint (io/twin); misfit: why it does not fit this shell, or empty."""

    finest: float
    errors: tuple[tuple[float, float], ...]
    misfit: str


@dataclass(frozen=True)
class Facts:
    """Facts of a scene.

    shells, surfaces: numbers of meshes with a shell, and with a surface material; objects: number of other surfaces. distant,
    point, area: numbers of distant lights, of point lights, and of emitters that a ray can meet; environment: there is one;
    seen: it is visible behind the scene. convex: no part of a mesh can shadow another part of it. enclosed: mean share of the
    directions from a surface that meet a surface again, for the mesh or object where it is largest; 0 only if none can. low:
    light may come from below the horizon of a shell's face. ground: albedo under the shells, 1 where it is not plain diffuse.
    coarsest: the largest footprint in texels that a pixel of a camera can have on the shells (one standard deviation to either
    side); rows: of their height features. baked: numbers of grids of their σ; magnified: how wide a column of these is seen
    from near, over a pixel's footprint; pixels: of the picture. inside: a camera may be in a shell. varying: names of
    appearance parameters that vary over the surface; shaped: geometry varies; tiled: a texture is corner tiles. passable:
    rays may pass the surface materials.
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
    magnified: float = np.inf
    baked: int = 0
    pixels: int = 0
    rows: int = 0
    inside: bool = False
    varying: tuple[str, ...] = ()
    shaped: bool = False
    tiled: bool = False
    passable: bool = False
    twin: TwinFacts | None = None

    @property
    def alone(self) -> bool:
        """There is one shell, on a convex mesh: light that has left it does not meet it again."""
        return self.convex and self.shells == 1 and not self.surfaces

    @property
    def lit(self) -> bool:
        return bool(self.distant or self.point or self.area or self.environment)
