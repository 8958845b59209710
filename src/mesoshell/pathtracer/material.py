"""A material from its bundle: filtered features and the network, in Dr.Jit (texture/mip, shell/field, shell/decoder).

Alphabet
ξ           (u, v, h), u and v in patches                                         (3,), canonical
r, σ_h      standard deviations of the filter on the tangent plane, in patches, and along the height
F           F(u, v) + F(h), each filtered                                         (C,)
α           appearance parameters, normalised                                     (A,)
σ, ρ        extinction and transport function
ω, ω′       toward the viewer, toward the light                                   (3,), canonical

Texels are stored once, all levels in one array; the network is evaluated by cooperative vectors in
the integrator's own loop (a network within a virtual call is 20 times slower).
"""

from typing import Any

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from mesoshell.io.bundle import Bundle

#: How far below the horizon, as a cosine, light still counts a little (shell/decoder).
FADE = 0.1
#: Up to so many half-precision numbers are widened: they are read in two thirds of the time.
MOST_WIDENED = 2**26
#: Cells of the σ grid along a patch's side, at most one a texel, where the texture has edges (shell/scene).
GRID_CELLS = 8


class Material:
    """A baked bundle on the device. origin: (u, v), in whole patches, at which a texture with edges begins."""

    def __init__(self, bundle: Bundle, origin: tuple[int, int] = (0, 0)):
        a = bundle.arrays
        self.channels, self.octaves = bundle.channels, bundle.height_octaves
        self.wraps, self.density, self.origin = bundle.wraps, float(bundle.texel_density), origin
        self.names = tuple(p.name for p in bundle.parameters if p.role == "alpha")
        self.plane = _Levels([a[f"features/{i}"] for i in range(_count(a, "features/{}"))])
        self.profile = _Levels([a[f"height/{i}"][:, None] for i in range(_count(a, "height/{}"))])
        self.grid = _Levels([a[f"grid/{i}"] for i in range(len(self.plane.shapes))], wide=False)
        self.scale = float(a["sigma_scale"])
        self.trunk, self.sigma = _network(a, "decoder/trunk", "decoder/sigma")
        self.head, self.rho = _network(a, "decoder/head", "decoder/rho")
        self.features = len(a["decoder/sigma/kernel"])

    def level(self, radius):
        """Level at which a texel is as wide as the footprint's ±1 standard deviation."""
        return _level(radius, self.density, len(self.plane.shapes) - 1)

    def bound(self, xi, level):
        """Largest σ that the material can have near ξ at this level."""
        l = mi.UInt32(level)
        h, v, u = (dr.gather(mi.UInt32, self.grid.sizes[k], l) for k in range(3))
        if self.wraps:
            x, y = (xi.x - dr.floor(xi.x)) * mi.Float(u), (xi.y - dr.floor(xi.y)) * mi.Float(v)
        else:
            last = dr.gather(mi.Float, self.cells, l)
            x, y = (xi.x - self.origin[0]) * last, (xi.y - self.origin[1]) * last
        cell = [_index(c, n) for c, n in ((xi.z * mi.Float(h), h), (y, v), (x, u))]
        first = dr.gather(mi.UInt32, self.grid.offset, l)
        return mi.Float(dr.gather(self.grid.scalar, self.grid.rows, first + (cell[0] * v + cell[1]) * u + cell[2]))

    @property
    def cells(self):
        """Cells a patch of each level's grid, of a texture with edges."""
        levels = range(len(self.plane.shapes))
        return mi.Float([float(min(GRID_CELLS, max(1, int(self.density) >> i))) for i in levels])

    def inputs(self, xi, radius, deviation, alpha):
        """What the trunk sees: filtered F(u, v) + F(h), encoded height, α. alpha: a list of floats."""
        plane = _between_levels(self.level(radius), len(self.plane.shapes) - 1, lambda l: self._bilinear(xi, l))
        rows = float(self.profile.shapes[0][0])
        last = len(self.profile.shapes) - 1
        profile = _between_levels(_level(deviation, rows, last), last, lambda l: self._linear(xi.z, l))
        angles = [dr.pi * 2.0**k * xi.z for k in range(self.octaves)]
        encoded = [xi.z, *(dr.sin(x) for x in angles), *(dr.cos(x) for x in angles)]
        return [*(plane[c] + profile[c] for c in range(self.channels)), *encoded, *alpha]

    def density_of(self, inputs):
        """σ, and the trunk's features as a cooperative vector."""
        x = nn.CoopVec(*inputs)
        for weight, bias in self.trunk:
            x = dr.maximum(nn.matvec(weight, x, bias), 0)
        (raw,) = nn.matvec(self.sigma[0], x, self.sigma[1])
        return self.scale * _softplus(raw - 3), x

    def transport(self, features, w, w_light):
        """ρ(ω, ω′), RGB, from the trunk's features and two canonical directions."""
        view, light = _above(w), _above(w_light)
        x = nn.CoopVec(*features, view.x, view.y, view.z, light.x, light.y, light.z)
        for weight, bias in self.head:
            x = dr.maximum(nn.matvec(weight, x, bias), 0)
        rgb = list(nn.matvec(self.rho[0], x, self.rho[1]))
        fade = dr.clip(1 + w_light.z / FADE, 0, 1)
        return fade * mi.Color3f(*(_softplus(y - 2) for y in rgb))

    def _bilinear(self, xi, l):
        height, width = (dr.gather(mi.UInt32, self.plane.sizes[k], l) for k in range(2))
        offset = dr.gather(mi.UInt32, self.plane.offset, l)
        if self.wraps:
            x = (xi.x - dr.floor(xi.x)) * mi.Float(width) - 0.5
            y = (xi.y - dr.floor(xi.y)) * mi.Float(height) - 0.5
        else:
            scale = dr.exp2(-mi.Float(l)) * self.density
            x = dr.clip((xi.x - self.origin[0]) * scale - 0.5, 0, mi.Float(width) - 1)
            y = dr.clip((xi.y - self.origin[1]) * scale - 0.5, 0, mi.Float(height) - 1)
        i, j = dr.floor(x), dr.floor(y)
        fx, fy = x - i, y - j
        columns, lines = ([self._texel(k, n) for k in (m, m + 1)] for m, n in ((i, width), (j, height)))
        total = [mi.Float(0)] * self.channels
        for line, wy in zip(lines, (1 - fy, fy), strict=True):
            for column, wx in zip(columns, (1 - fx, fx), strict=True):
                row, weight = self.plane.row(offset + line * width + column), wx * wy
                total = [s + weight * r for s, r in zip(total, row, strict=True)]
        return total

    def _texel(self, i, n):
        """Index of texel i of n, wrapped or clamped."""
        size = mi.Float(n)
        if self.wraps:
            i = dr.select(i < 0, i + size, dr.select(i >= size, i - size, i))
        return mi.UInt32(dr.clip(i, 0, size - 1))

    def _linear(self, h, l):
        rows = dr.gather(mi.UInt32, self.profile.sizes[0], l)
        offset = dr.gather(mi.UInt32, self.profile.offset, l)
        z = dr.clip(h * mi.Float(rows) - 0.5, 0, mi.Float(rows) - 1)
        i = dr.floor(z)
        f = z - i
        low = self.profile.row(offset + mi.UInt32(i))
        high = self.profile.row(offset + dr.minimum(mi.UInt32(i) + 1, rows - 1))
        return [(1 - f) * a + f * b for a, b in zip(low, high, strict=True)]


class _Levels:
    """Arrays of several levels, one after the other. wide: rows of the last axis are read whole; else single numbers."""

    def __init__(self, levels: list[np.ndarray], wide: bool = True):
        half = all(x.dtype == np.float16 for x in levels) and sum(x.size for x in levels) > MOST_WIDENED
        self._vector: Any
        self.scalar, self._vector = (mi.Float16, mi.ArrayXf16) if half else (mi.Float, mi.ArrayXf)
        self.width = levels[0].shape[-1] if wide else 1
        self.rows = self.scalar(np.concatenate([x.ravel() for x in levels]).astype(np.float16 if half else np.float32))
        self.shapes = [x.shape for x in levels]
        self.sizes = [mi.UInt32([s[k] for s in self.shapes]) for k in range(levels[0].ndim)]
        self.offset = mi.UInt32(np.cumsum([0, *(x.size // self.width for x in levels[:-1])]).astype(np.uint32))

    def row(self, index):
        """One row as a list of float32."""
        found = dr.gather(self._vector, self.rows, index, shape=(self.width, dr.width(index)))
        return [mi.Float(found[c]) for c in range(self.width)]


def _network(a: dict[str, np.ndarray], hidden: str, last: str) -> tuple[list[Any], Any]:
    """Layers as (weight, bias) views of one packed buffer: the hidden ones, and the last."""
    names = [*(f"{hidden}/{i}" for i in range(_count(a, hidden + "/{}/kernel"))), last]
    parts = []
    for name in names:
        parts.append(mi.TensorXf(a[f"{name}/kernel"].T.astype(np.float32).copy()))
        parts.append(mi.TensorXf(a[f"{name}/bias"].astype(np.float32)))
    views = nn.pack(*parts, layout="inference")
    layers = list(zip(views[::2], views[1::2], strict=True))
    return layers[:-1], layers[-1]


def _count(a: dict[str, np.ndarray], key: str) -> int:
    n = 0
    while key.format(n) in a:
        n += 1
    return n


def _level(radius, density: float, last: int):
    width = 2 * radius * density
    return dr.log2(dr.clip(dr.select(dr.isnan(width), 1, width), 1, 2.0**last))


def _between_levels(level, last: int, at):
    """at(l), a list, of the level below and of the one above, blended."""
    lower = dr.floor(level)
    share, first = level - lower, mi.UInt32(lower)
    return [(1 - share) * a + share * b for a, b in zip(at(first), at(dr.minimum(first + 1, last)), strict=True)]


def _index(x, n):
    return mi.UInt32(dr.clip(x, 0, mi.Float(n) - 1))


def _softplus(x):
    """log(1 + eˣ), without overflow."""
    e = dr.exp(-dr.abs(x))
    return dr.maximum(x, 0) + dr.select(e < 1e-3, e * (1 - e / 2), dr.log(1 + e))


def _above(w):
    """A direction, brought to the horizon if it lies below (shell/decoder)."""
    flat = mi.Vector3f(w.x, w.y, dr.maximum(w.z, 0))
    length = dr.norm(flat)
    return dr.select(length > 0, flat / dr.select(length > 0, length, 1), 0)
