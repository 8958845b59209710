"""The materials of a scene's shells, as what is compiled and what it reads, chosen by the prism of a sample.

With one material nothing is chosen. All of them share one chart, so geometry is evaluated for all samples at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from mesoshell.io.density_grid import grid_shape
from mesoshell.render.camera import pixel_radius
from mesoshell.render.effects import MAX_BAKED, Effects
from mesoshell.render.quality import Quality
from mesoshell.shell.geometry.sampling import Chart
from mesoshell.shell.material.baked_density import baked_density
from mesoshell.shell.render.kernels import DeviceTables, StaticConfig
from mesoshell.shell.render.scene import Medium, Scene


class Decoding(NamedTuple):
    """How a material is decoded: the arguments that its kernels take first."""

    program: StaticConfig
    table: DeviceTables


class Decoded(NamedTuple):
    """Samples of one material: which of a wave's they are, and what each batch of them gave."""

    medium: Decoding
    own: Int[np.ndarray, "M"]
    batches: list


class Media:
    """The materials of a scene. each: how each is decoded, once where several meshes share it, with the grid of its density if
    that is baked."""

    def __init__(self, scene: Scene, quality: Quality, effects: Effects, chart: Chart):
        self.chart = chart
        different = _different(scene)
        shapes = density_shapes(scene) if effects.baked_density.on else [None] * len(different)
        self.each = [
            _decoding(medium, shape, scene, quality, effects, chart)
            for medium, shape in zip(different.values(), shapes, strict=True)
        ]
        self._first = np.array([medium.prism for medium in scene.media], np.int64)
        self._of = np.array([list(different).index(_key(medium)) for medium in scene.media], np.int64)

    def parts(self, prism: Int[np.ndarray, "S"]) -> Iterator[tuple[Decoding, Int[np.ndarray, "M"]]]:
        """Each material of some samples, and which of them are its own. prism: of each sample."""
        if len(self.each) == 1:
            yield self.each[0], np.arange(len(prism))
            return
        which = self._of[np.searchsorted(self._first, prism, side="right") - 1]
        for k, decoding in enumerate(self.each):
            own = np.flatnonzero(which == k)
            if len(own):
                yield decoding, own


def density_shapes(scene: Scene) -> list[tuple[int, ...]]:
    """Shapes of the grids of density, one for all media that are decoded alike."""
    different = _different(scene).values()
    return [_grid_shape(medium, MAX_BAKED // len(different)) for medium in different]


def density_columns(medium: Medium, most: int) -> float:
    """Columns a patch of a medium's grid, along the side that has fewer. most: numbers that it may hold."""
    layout, (lines, columns) = medium.device_material.layout, _grid_shape(medium, most)[-3:-1]
    if layout.open:
        return layout.texel_density * columns / layout.sizes[0][1]
    return min(lines, columns) / layout.period


def _grid_shape(medium: Medium, most: int) -> tuple[int, ...]:
    return grid_shape(medium.device_material.layout.sizes[0], len(_varying(medium)), most)


def _different(scene: Scene) -> dict[tuple, Medium]:
    """Media that are decoded differently: of several that are alike, the first."""
    found: dict[tuple, Medium] = {}
    for medium in scene.media:
        found.setdefault(_key(medium), medium)
    return found


def _key(medium: Medium) -> tuple:
    """What media have in common that are decoded alike."""
    maps = tuple((name, id(image)) for name, image in medium.maps.items())
    return id(medium.device_material), medium.alpha.tobytes(), maps, medium.patches_per_uv if maps else None


def _varying(medium: Medium) -> tuple[int, ...]:
    """Positions in α of what varies over the surface."""
    return tuple(i for i, name in enumerate(medium.device_material.names) if name in medium.maps)


def _decoding(
    medium: Medium, baked: tuple[int, ...] | None, scene: Scene, quality: Quality, effects: Effects, chart: Chart
) -> Decoding:
    """baked: shape of the grid, if density is read from one."""
    device_material = medium.device_material
    varying = _varying(medium) if effects.varying_parameters.on or baked is not None else ()
    program = StaticConfig(
        device_material.layout,
        device_material.grid_shapes,
        effects.filtering.on,
        quality.anisotropy if effects.anisotropic_filtering.on else 1,
        quality.coordinates == "exact",
        varying,
        baked,
    )
    table = DeviceTables(
        chart,
        device_material.material_for(effects.filtering.on),
        device_material.grid,
        jnp.asarray(medium.alpha, jnp.float32),
        tuple(jnp.asarray(medium.maps[device_material.names[i]], jnp.float32) for i in varying),
        jnp.asarray(medium.patches_per_uv, jnp.float32),
        jnp.asarray(quality.footprint * pixel_radius(scene.camera.spread), jnp.float32),
        jnp.asarray(quality.height_filter, jnp.float32),
        None if baked is None else baked_density(device_material, medium.alpha, varying, baked),
    )
    return Decoding(program, table)
