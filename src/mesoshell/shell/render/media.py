"""The materials of a scene's shells, as what is compiled and what it reads, chosen by the prism of a sample.

With one material nothing is chosen. All of them share one chart, so geometry is evaluated for all samples at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from mesoshell.render.camera import pixel_radius
from mesoshell.render.effects import Effects
from mesoshell.render.quality import Quality
from mesoshell.shell.geometry.sampling import Chart
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
    """The materials of a scene. each: how each is decoded, once where several meshes share it."""

    def __init__(self, scene: Scene, quality: Quality, effects: Effects, chart: Chart):
        self.chart = chart
        alike: dict[tuple, list[Medium]] = {}
        for medium in scene.media:
            alike.setdefault(_key(medium), []).append(medium)
        self.each = [_decoding(media[0], scene, quality, effects, chart) for media in alike.values()]
        self._first = np.array([medium.prism for medium in scene.media], np.int64)
        self._of = np.array([list(alike).index(_key(medium)) for medium in scene.media], np.int64)

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


def _key(medium: Medium) -> tuple:
    """What media have in common that are decoded alike."""
    maps = tuple((name, id(image)) for name, image in medium.maps.items())
    return id(medium.device_material), medium.alpha.tobytes(), maps, medium.patches_per_uv if maps else None


def _decoding(medium: Medium, scene: Scene, quality: Quality, effects: Effects, chart: Chart) -> Decoding:
    device_material = medium.device_material
    varying = (
        tuple(i for i, n in enumerate(device_material.names) if n in medium.maps)
        if effects.varying_parameters.on
        else ()
    )
    program = StaticConfig(
        device_material.layout,
        device_material.grid_shapes,
        effects.filtering.on,
        quality.anisotropy if effects.anisotropic_filtering.on else 1,
        quality.coordinates == "exact",
        varying,
    )
    maps = [medium.maps[device_material.names[i]] for i in varying]
    table = DeviceTables(
        chart,
        device_material.material_for(effects.filtering.on),
        device_material.grid,
        jnp.asarray(medium.alpha, jnp.float32),
        jnp.asarray(np.stack(maps) if maps else np.zeros((0, 1, 1)), jnp.float32),
        jnp.asarray(medium.patches_per_uv, jnp.float32),
        jnp.asarray(quality.footprint * pixel_radius(scene.camera.spread), jnp.float32),
        jnp.asarray(quality.height_filter, jnp.float32),
    )
    return Decoding(program, table)
