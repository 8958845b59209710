"""The materials of all shells of a scene, chosen by the prism of a sample.

Notation
α           appearance parameters of a shell, normalised                           (A,)

Nothing that a scene lacks is compiled: with one material there is no choice among them, with one shell α is a constant.
taps: of the filter (pathtracer/material).
"""

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mesoshell.io.density_grid import grid_shape
from mesoshell.pathtracer.baked_density import BakedDensity
from mesoshell.pathtracer.maps import look_up
from mesoshell.pathtracer.material import Material
from mesoshell.render.effects import MAX_BAKED


@dataclass(frozen=True, eq=False)
class Medium:
    """The medium of one shell. alpha: numbers in [0, 1], or textures of the scene that give them, each over the mesh's UV;
    patches: texture patches along one unit of that UV; flipped: Mitsuba's v is 1 minus ours."""

    material: Material
    alpha: tuple
    patches: float = 1.0
    flipped: bool = False

    @property
    def varying(self) -> list[str]:
        """Names of parameters that textures give."""
        return [name for name, v in zip(self.material.names, self.alpha, strict=True) if not isinstance(v, float)]


class Media:
    """Media of shells, in the order of `Shells`."""

    def __init__(self, shells, media: list[Medium]):
        self.media, self.shell = media, shells.shell
        self.materials = list(dict.fromkeys(m.material for m in media))
        self.material_of = mi.UInt32([self.materials.index(m.material) for m in media])
        self.baked: dict[Material, BakedDensity] = {}
        # as constants in a kernel, another value would compile another kernel
        self._values = {v: dr.opaque(mi.Float, v) for m in media for v in m.alpha if isinstance(v, float)}

    def bound(self, sample, taps=1):
        """Largest σ that is possible near a sample."""
        return self._choose(sample, lambda m: m.bound(sample.xi, m.level(sample.radius, taps)), mi.Float(0))

    def cells(self, sample, taps=1):
        """Cells of the σ grid along one unit of u, v and h where a sample lies."""
        return self._choose(sample, lambda m: m.cells_along(m.level(sample.radius, taps)), mi.Vector3f(1))

    def sigma(self, sample, taps=1, baked=False):
        """σ of a sample: by the network, or from grids that `bake` made."""

        def one(m):
            if baked:
                return self.baked[m].at(sample.xi, self._alpha(m, sample))
            return m.density_of(self._inputs(m, sample, taps))[0]

        return self._choose(sample, one, mi.Float(0))

    def bake(self) -> None:
        """Make the grids of all materials that have none."""
        for material in self.materials:
            if material not in self.baked:
                alpha = common_alpha(self.media, material)
                self.baked[material] = BakedDensity(material, alpha, MAX_BAKED // len(self.materials))

    def decode(self, sample, taps=1):
        """σ of a sample, and the trunk's features for `rho`."""
        widest = max(m.features for m in self.materials)

        def one(m):
            sigma, x = m.density_of(self._inputs(m, sample, taps))
            return sigma, [*x, *(mi.Float(0) for _ in range(widest - m.features))]

        return self._choose(sample, one, (mi.Float(0), [mi.Float(0) for _ in range(widest)]))

    def rho(self, sample, features, w, w_lights):
        """ρ(ω, ω′) of a sample for each of some ω′, canonical."""

        def one(m):
            return [m.transport(features[: m.features], w, w_light) for w_light in w_lights]

        return self._choose(sample, one, [mi.Color3f(0) for _ in w_lights])

    def _inputs(self, material, sample, taps):
        return material.inputs(sample, self._alpha(material, sample), taps)

    def _alpha(self, material, sample):
        mine = [i for i, m in enumerate(self.media) if m.material is material]
        shell = dr.gather(mi.UInt32, self.shell, sample.prism) if len(self.media) > 1 else mi.UInt32(mine[0])
        return [self._parameter(k, mine, shell, sample) for k in range(len(material.names))]

    def _parameter(self, k, mine, shell, sample):
        values = [self.media[i].alpha[k] for i in mine]
        if all(isinstance(v, float) for v in values):
            if len(set(values)) == 1:
                return self._values[values[0]]
            table = [m.alpha[k] if m.material is self.media[mine[0]].material else 0.0 for m in self.media]
            return dr.gather(mi.Float, mi.Float(table), shell)
        total = mi.Float(0)
        for i, value in zip(mine, values, strict=True):
            total = dr.select(shell == i, _at(value, sample, self.media[i]), total)
        return total

    def _choose(self, sample, what, nothing):
        if len(self.materials) == 1:
            return what(self.materials[0])
        which = dr.gather(mi.UInt32, self.material_of, dr.gather(mi.UInt32, self.shell, sample.prism))
        for i, material in enumerate(self.materials):
            nothing = dr.if_stmt(
                (nothing, which), which == i, lambda x, w, m=material: (what(m), w), lambda x, w: (x, w)
            )[0]
        return nothing


def common_alpha(media: list[Medium], material: Material) -> list[float | None]:
    """Each parameter that is the same wherever a material is; None for one that varies."""
    values = [set(same) for same in zip(*(m.alpha for m in media if m.material is material), strict=True)]
    return [next(iter(v)) if len(v) == 1 and isinstance(next(iter(v)), float) else None for v in values]


def baked_size(media: list[Medium]) -> int:
    """Numbers of the grids of all materials."""
    return sum(math.prod(_grid(media, m)) for m in dict.fromkeys(m.material for m in media))


def grid_columns(media: list[Medium]) -> list[float]:
    """Columns a patch of each medium's grid."""
    wide = [(m.material, _grid(media, m.material)[-2] / m.material.plane.shapes[0][1]) for m in media]
    return [material.density * columns for material, columns in wide]


def _grid(media: list[Medium], material: Material) -> tuple[int, ...]:
    most = MAX_BAKED // len({m.material for m in media})
    return grid_shape(material.plane.shapes[0], common_alpha(media, material).count(None), most)


def _at(value, sample, medium: Medium):
    """A parameter at a sample: a number, or a texture looked up at the mesh's UV."""
    if isinstance(value, float):
        return mi.Float(value)
    return look_up(value, sample.xi.x / medium.patches, sample.xi.y / medium.patches, medium.flipped)
