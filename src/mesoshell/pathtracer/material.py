"""A material from its bundle: filtered features and the network, in Dr.Jit (texture/mip, shell/material).

Notation
ξ           (u, v, h), u and v in patches                                         (3,), canonical
r, σ_h      standard deviations of the filter on the tangent plane, in patches, and along the height
taps        lookups along the long axis of the footprint (shell/render/kernels); 0: the finest levels, unfiltered
s           radius of a circle as large as all that is averaged: r, or of an ellipse with taps
δ           correction of averaged features, at the level of s (shell/material/field)
F           F(u, v) + F(h) + δ, each filtered                                     (C,)
α           appearance parameters, normalised                                     (A,)
σ, ρ        extinction and transport function
ω, ω′       toward the viewer, toward the light                                   (3,), canonical
"""

import math

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from mesoshell.io.bundle import FADE, GRID_CELLS, Bundle
from mesoshell.io.corner_tiles import FACTORS, LAST, ROUNDS, SIDE, places
from mesoshell.io.density_grid import finest_digest, grid_shape
from mesoshell.pathtracer.heights import Heights
from mesoshell.pathtracer.levels import Levels, between_levels, count, level_of, network, softplus
from mesoshell.render.effects import MAX_BAKED


def gaussian_taps(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and weights of n taps of a Gaussian cut at ±2.3 standard deviations, of variance 1 (shell/render/kernels)."""
    positions = (np.arange(n) + 0.5) / n * 4.6 - 2.3
    weights = np.exp(-positions * positions / 2)
    weights /= weights.sum()
    return positions / np.sqrt(weights @ positions**2), weights


class Material:
    """A baked bundle on the device. origin: (u, v), in whole patches, at which a texture with edges begins, or that of a seed
    of corner tiles."""

    def __init__(self, bundle: Bundle, origin: tuple[int, int] = (0, 0)):
        a = bundle.arrays
        self.channels, self.octaves = bundle.channels, bundle.height_octaves
        self.wraps, self.density, self.origin = bundle.wraps, float(bundle.texel_density), origin
        self.tiles = None if bundle.tiles is None else mi.UInt32(places(bundle.tiles).ravel())
        # as constants in a kernel, another seed would compile another kernel
        self.first_tile = tuple(dr.opaque(mi.UInt32, n % 2**32) for n in origin)
        self.names = tuple(p.name for p in bundle.parameters if p.role == "alpha")
        self.plane = Levels([a[f"features/{i}"] for i in range(count(a, "features/{}"))])
        self.heights = Heights(a, origin)
        self.correction = Levels([level[None] for level in a["correction"]]) if "correction" in a else None
        self.finest_corrected = bundle.finest_corrected
        self.grid = Levels([a[f"grid/{i}"] for i in range(len(self.plane.shapes))], wide=False)
        self.scale = float(a["sigma_scale"])
        self.trunk, self.sigma = network(a, "decoder/trunk", "decoder/sigma")
        self.head, self.rho = network(a, "decoder/head", "decoder/rho")
        self.features = len(a["decoder/sigma/kernel"])
        bakes = math.prod(grid_shape(self.plane.shapes[0], 0, MAX_BAKED)) <= MAX_BAKED
        self.digest = finest_digest(bundle) if bakes else ""

    def level(self, radius, taps=1):
        """Level at which a texel is as wide as the footprint's ±1 standard deviation; None for the finest."""
        return level_of(radius, self.density, len(self.plane.shapes) - 1) if taps else None

    def bound(self, xi, level):
        """Largest σ that the material can have near ξ at this level."""
        l = mi.UInt32(0 if level is None else level)
        h, v, u = (dr.gather(mi.UInt32, self.grid.sizes[k], l) for k in range(3))
        if self.wraps:
            at = self._on_texture(xi)
            x, y = (at.x - dr.floor(at.x)) * mi.Float(u), (at.y - dr.floor(at.y)) * mi.Float(v)
        else:
            last = dr.gather(mi.Float, self.cells, l)
            x, y = (xi.x - self.origin[0]) * last, (xi.y - self.origin[1]) * last
        cell = [_index(c, n) for c, n in ((xi.z * mi.Float(h), h), (y, v), (x, u))]
        first = dr.gather(mi.UInt32, self.grid.offset, l)
        return mi.Float(dr.gather(self.grid.scalar, self.grid.rows, first + (cell[0] * v + cell[1]) * u + cell[2]))

    def cells_along(self, level):
        """Cells of this level's grid along one unit of u, v and h."""
        l = mi.UInt32(0 if level is None else level)
        h, v, u = (mi.Float(dr.gather(mi.UInt32, self.grid.sizes[k], l)) for k in range(3))
        if not self.wraps:
            u = v = dr.gather(mi.Float, self.cells, l)
        elif self.tiles is not None:
            u, v = u / SIDE, v / SIDE
        return mi.Vector3f(u, v, h)

    @property
    def cells(self):
        """Cells a patch of each level's grid, of a texture with edges."""
        levels = range(len(self.plane.shapes))
        return mi.Float([float(min(GRID_CELLS, max(1, int(self.density) >> i))) for i in levels])

    def inputs(self, sample, alpha, taps=1):
        """Inputs of the trunk: filtered F(u, v) + F(h) + δ, encoded height, α. alpha: a list of floats."""
        xi = sample.xi
        plane = self._along(sample, taps) if taps > 1 else self._filtered(xi, self.level(sample.radius, taps))
        if self.correction is not None and (taps or self.finest_corrected):
            plane = _plus(plane, 1, self._correction(self.correction, sample, taps))
        return self._of_features(plane, xi, sample.deviation if taps else None, alpha)

    def inputs_on_texture(self, x, y, h, alpha):
        """`inputs` at (x, y) on the texture's finest level, in texels from the centre of the first, unfiltered."""
        plane = self.plane.bilinear(x, y, mi.UInt32(0), self.wraps)
        if self.correction is not None and self.finest_corrected:
            plane = _plus(plane, 1, self.correction.linear(h, mi.UInt32(0)))
        u, v = ((c + 0.5) / self.density + begin for c, begin in zip((x, y), self.origin, strict=True))
        return self._of_features(plane, mi.Vector3f(u, v, h), None, alpha)

    def _of_features(self, plane, xi, deviation, alpha):
        profile = self.heights.at(xi, deviation)
        angles = [dr.pi * 2.0**k * xi.z for k in range(self.octaves)]
        encoded = [xi.z, *(dr.sin(x) for x in angles), *(dr.cos(x) for x in angles)]
        return [*(plane[c] + profile[c] for c in range(self.channels)), *encoded, *alpha]

    def density_of(self, inputs):
        """σ, and the trunk's features as a cooperative vector."""
        x = nn.CoopVec(*inputs)
        for weight, bias in self.trunk:
            x = dr.maximum(nn.matvec(weight, x, bias), 0)
        (raw,) = nn.matvec(self.sigma[0], x, self.sigma[1])
        return self.scale * softplus(raw - 3), x

    def transport(self, features, w, w_light):
        """ρ(ω, ω′), RGB, from the trunk's features and two canonical directions."""
        view, light = _above(w), _above(w_light)
        x = nn.CoopVec(*features, view.x, view.y, view.z, light.x, light.y, light.z)
        for weight, bias in self.head:
            x = dr.maximum(nn.matvec(weight, x, bias), 0)
        rgb = list(nn.matvec(self.rho[0], x, self.rho[1]))
        fade = dr.clip(1 + w_light.z / FADE, 0, 1)
        return fade * mi.Color3f(*(softplus(y - 2) for y in rgb))

    def _on_texture(self, xi):
        """ξ in the period of a texture that wraps."""
        if self.tiles is None:
            return xi
        u, v = dr.floor(xi.x), dr.floor(xi.y)
        i, j = (mi.Float(x) for x in self._tile(mi.Int32(u), mi.Int32(v)))
        return mi.Vector3f((i + xi.x - u) / SIDE, (j + xi.y - v) / SIDE, xi.z)

    def _tile(self, i, j):
        """The patch of the torus that a patch of the plane shows (shell/material/corner_tiles)."""
        i, j = mi.UInt32(i) + self.first_tile[0], mi.UInt32(j) + self.first_tile[1]
        tile = mi.UInt32(0)
        for k, corner in enumerate(((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))):
            tile |= _colour(*corner) << k
        return [mi.Int32(dr.gather(mi.UInt32, self.tiles, 2 * tile + k)) for k in (0, 1)]

    def _filtered(self, xi, level):
        return between_levels(level, len(self.plane.shapes) - 1, lambda l: self._bilinear(xi, l))

    @dr.syntax
    def _along(self, sample, taps):
        """F(u, v) averaged over taps along the footprint's long axis."""
        positions, weights = gaussian_taps(taps)
        radius = self._radius(sample, taps)
        # each tap is as wide as radius along the axis, too
        reach = dr.sqrt(dr.maximum(dr.square(sample.major) - dr.square(radius), 0))
        level = self.level(radius)
        place, share = mi.Float(positions), mi.Float(weights)
        total, k = [mi.Float(0)] * self.channels, mi.UInt32(0)
        while k < taps:
            move = dr.gather(mi.Float, place, k) * reach
            at = mi.Vector3f(sample.xi.x + move * sample.axis.x, sample.xi.y + move * sample.axis.y, sample.xi.z)
            features, weight = self._filtered(at, level), dr.gather(mi.Float, share, k)
            total = _plus(total, weight, features)
            k += 1
        return total

    def _correction(self, levels, sample, taps):
        """δ of a sample. levels: of the correction."""
        spread = dr.sqrt(sample.major * self._radius(sample, taps)) if taps > 1 else sample.radius
        last = len(self.plane.shapes) - 1
        return between_levels(self.level(spread, taps), last, lambda l: levels.linear(sample.xi.z, l))

    def _radius(self, sample, taps):
        """Radius of a tap."""
        positions, _ = gaussian_taps(taps)
        spacing = sample.major * float(positions[1] - positions[0])
        return dr.minimum(dr.maximum(sample.radius, 0.35 * spacing), sample.major)

    def _bilinear(self, xi, l):
        if self.tiles is not None:
            return self._bilinear_tiled(xi, l, *self.plane.size(l))
        return self.plane.bilinear(*self.texels(xi, l), l, self.wraps)

    def texels(self, xi, l):
        """(x, y) of ξ on the texture, in a level's texels from the centre of the first; beyond edges, a texel at most."""
        height, width = self.plane.size(l)
        if self.wraps:
            at = self._on_texture(xi)
            return (at.x - dr.floor(at.x)) * mi.Float(width) - 0.5, (at.y - dr.floor(at.y)) * mi.Float(height) - 0.5
        scale = dr.exp2(-mi.Float(l)) * self.density
        x = dr.clip((xi.x - self.origin[0]) * scale - 0.5, -1, mi.Float(width))
        return x, dr.clip((xi.y - self.origin[1]) * scale - 0.5, -1, mi.Float(height))

    def _bilinear_tiled(self, xi, l, height, width):
        """Read each of the four texels from the tile at its own patch (texture/mip)."""
        texels = dr.maximum(mi.Int32(int(self.density) >> l), 1)
        u, v = dr.floor(xi.x), dr.floor(xi.y)
        x, y = (xi.x - u) * mi.Float(texels) - 0.5, (xi.y - v) * mi.Float(texels) - 0.5
        fx, fy = x - dr.floor(x), y - dr.floor(y)
        columns, lines = ([mi.Int32(dr.floor(a)) + k for k in (0, 1)] for a in (x, y))
        total = [mi.Float(0)] * self.channels
        for line, wy in zip(lines, (1 - fy, fy), strict=True):
            for column, wx in zip(columns, (1 - fx, fx), strict=True):
                du, dv = (dr.select(c < 0, -1, dr.select(c >= texels, 1, 0)) for c in (column, line))
                i, j = self._tile(mi.Int32(u) + du, mi.Int32(v) + dv)
                at = dr.minimum(mi.UInt32((i - du) * texels + column), width - 1)
                on = dr.minimum(mi.UInt32((j - dv) * texels + line), height - 1)
                row = self.plane.row(dr.gather(mi.UInt32, self.plane.offset, l) + on * width + at)
                total = _plus(total, wx * wy, row)
        return total


def _colour(i, j):
    """Colour of a corner of the patch lattice."""
    h = i * FACTORS[0] ^ j * FACTORS[1]
    for factor, shift in ROUNDS:
        h = (h ^ (h >> shift)) * factor
    return (h ^ (h >> LAST)) & 1


def _plus(total, weight, row):
    return [t + weight * x for t, x in zip(total, row, strict=True)]


def _index(x, n):
    return mi.UInt32(dr.clip(x, 0, mi.Float(n) - 1))


def _above(w):
    """A direction, clamped to the horizon (shell/material/decoder)."""
    flat = mi.Vector3f(w.x, w.y, dr.maximum(w.z, 0))
    length = dr.norm(flat)
    return dr.select(length > 0, flat / dr.select(length > 0, length, 1), 0)
