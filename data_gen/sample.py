"""Random camera, light and parameters of one sample, from a hash.  Pure Python and NumPy.

Notation
    frame     the unit box [0, 1]³, right-handed, z up; (x, y, z) are the canonical (u, v, h)
    c         the box's centre (0.5, 0.5, 0.5), which every camera looks at
    r         camera radius, its distance from c, in box sides
    fov       full angle of view of the square frame, radians
    k         coverage: the box's side at distance r over the frame's width there, 1 / (2 r tan(fov / 2))
    light     unit vector from the box toward the distant light
    instance  seed of the geometry; side: of the torus it grows on, in patches (see recipe)
    views     images of one patch in a dataset of many patches: image i shows patch i // views
    tiles     whether the geometry is that of corner tiles (see tiles): image i shows tile i mod 16

Every draw is a SHA-256 of (recipe, version, seed, index, name of the draw). So a sample depends neither on the
order nor on the process that renders it, and fixing one parameter leaves all the other draws as they were.
The geometry parameters of patch k of many are drawn from (recipe, version, "patch", k, name): datasets of other seeds
show the same patches from other cameras; all tiles have those of patch 0.
Cameras and lights are uniform in solid angle above a smallest elevation.  Coverage is log-uniform, in two parts:
most images (`LARGE_SHARE`) show the box at `LARGE_COVERAGE` or more, for a far image carries few pixels of it.
"""

import hashlib
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from data_gen import tiles
from data_gen.recipe import Growth, Recipe

CENTRE = (0.5, 0.5, 0.5)
FIELD_OF_VIEW = 0.4
CAMERA_ELEVATION = math.radians(3.0)
LIGHT_ELEVATION = math.radians(5.0)
SMALLEST_BOX_PIXELS = 8.0
LARGEST_COVERAGE = 2.0
LARGE_COVERAGE = 0.4
LARGE_SHARE = 0.8


class Sample(NamedTuple):
    index: int
    cycles_seed: int
    parameters: dict[str, float]
    instance: int
    side: int
    camera_to_world: np.ndarray
    radius: float
    light: np.ndarray


class Drawer(NamedTuple):
    """What the draws of a dataset share. `fixed` holds the parameters that are not drawn.

    patch: None, and every sample has an instance of its own that covers the slab; or the seed of one patch, repeated
    3 × 3, that all samples show (the periodic patch that a fit needs).
    views: None, or how many images in turn show the same patch; then patch is None, and patches are 0, 1, 2, …
    tiles: images show the tiles in turn, each among its neighbours; then patch and views are None.
    """

    recipe: Recipe
    seed: int
    coverage: tuple[float, float]
    fixed: Mapping[str, float]
    patch: int | None
    views: int | None = None
    tiles: bool = False

    def uniform(self, index: int, name: str, seed: int | str | None = None) -> float:
        """A number in [0, 1), on a grid of 2⁻⁵³. seed: the dataset's if not given."""
        key = f"{self.recipe.name}/{self.recipe.version}/{self.seed if seed is None else seed}/{index}/{name}"
        return (int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big") >> 11) * 2.0**-53

    def draw(self, index: int) -> Sample:
        patch = self.patch if self.views is None else index // self.views
        patch = index % tiles.SIDE**2 if self.tiles else patch
        parameters = {}
        for name, parameter in self.recipe.parameters.items():
            low, high = parameter.range
            shared = (self.views is not None or self.tiles) and parameter.role == "beta"
            of = (0 if self.tiles else patch, f"parameter/{name}", "patch") if shared else (index, f"parameter/{name}")
            parameters[name] = float(self.fixed.get(name, low + (high - low) * self.uniform(*of)))
        pick, within = self.uniform(index, "coverage/part"), self.uniform(index, "coverage/within")
        radius = radius_of(draw_coverage(self.coverage, pick, within))
        toward_camera = self._direction(index, "camera", CAMERA_ELEVATION)
        return Sample(
            index=index,
            cycles_seed=int(self.uniform(index, "cycles") * 2**31),
            parameters=parameters,
            instance=int(self.uniform(index, "instance") * 2**53) if patch is None else patch,
            side=3 if patch is None or self.tiles else 1,
            camera_to_world=looking_along_minus_z(toward_camera, np.asarray(CENTRE) + radius * axis_z(*toward_camera)),
            radius=radius,
            light=axis_z(*self._direction(index, "light", LIGHT_ELEVATION)),
        )

    def grow(self, drawn: Sample) -> Growth:
        """The geometry of a sample, on [0, side)². Raises ValueError if tiles cannot be made of it."""
        if self.tiles:
            return tiles.slab(self.recipe.grow, drawn.instance, drawn.parameters)
        return self.recipe.grow(np.random.default_rng(drawn.instance), drawn.side, drawn.parameters)

    def _direction(self, index: int, name: str, elevation: float) -> tuple[float, float]:
        """(sine of the elevation, azimuth), uniform in solid angle: the area of a sphere's zone goes as its height."""
        low = math.sin(elevation)
        sine = low + (1.0 - low) * self.uniform(index, f"{name}/sine")
        return sine, 2.0 * math.pi * self.uniform(index, f"{name}/azimuth")


def radius_of(coverage: float) -> float:
    return 1.0 / (2.0 * coverage * math.tan(FIELD_OF_VIEW / 2.0))


def default_coverage(size: int) -> tuple[float, float]:
    """From a box of 8 pixels (or the whole of a frame smaller than that) to a box of twice the frame."""
    return min(SMALLEST_BOX_PIXELS / size, 1.0), LARGEST_COVERAGE


def draw_coverage(span: tuple[float, float], pick: float, within: float) -> float:
    low, high = span
    if low < LARGE_COVERAGE < high:
        low, high = (LARGE_COVERAGE, high) if pick < LARGE_SHARE else (low, LARGE_COVERAGE)
    return low * (high / low) ** within


def axis_z(sine: float, azimuth: float) -> np.ndarray:
    cosine = math.sqrt(max(0.0, 1.0 - sine * sine))
    return np.array([cosine * math.cos(azimuth), cosine * math.sin(azimuth), sine])


def looking_along_minus_z(direction: tuple[float, float], position: np.ndarray) -> np.ndarray:
    """Object-to-world 4×4 whose z axis is `direction` = (sine, azimuth), with x horizontal.

    x comes from the azimuth alone, so that the frame is defined at the zenith too.
    """
    z = axis_z(*direction)
    x = np.array([-math.sin(direction[1]), math.cos(direction[1]), 0.0])
    matrix = np.eye(4)
    matrix[:3, :] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return matrix
