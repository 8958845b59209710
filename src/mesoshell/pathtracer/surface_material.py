"""Meshes with surface materials, and these materials (surface_material/network, surface_material/tables, in Dr.Jit).

Notation
u            place on the texture, periods                                                                    (2,)
r            standard deviation of the ray's footprint there, periods
κ            curvature along the ray, 1 / period
ω, ω′        toward the viewer, toward the light, in the frame of a hit: t, b, n                              (3,)
α, ρ         opacity and reflectance

All such meshes are kept in a separate scene, as shells are: a ray that meets one may go through it.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from mesoshell.io.surface import SurfaceBundle
from mesoshell.pathtracer.levels import Levels, between_levels, level_of, network, softplus
from mesoshell.pathtracer.samples import IntervalFrame, no_frame
from mesoshell.pathtracer.shells import scene_of
from mesoshell.surface_material.tables import MIN_COSINE, SurfaceTables

#: Step past a surface, relative to the scene's size and the distance.
ADVANCE = 4e-6
#: Directions are drawn with a density in proportion to ω′_z + BELOW: light from below the horizon counts too.
BELOW = 1.25


class SurfaceMaterial:
    """A bundle on the device."""

    def __init__(self, bundle: SurfaceBundle):
        a, self.texels = bundle.arrays, float(bundle.texels)
        self.last = bundle.texels.bit_length() - 1
        self.opacity, self.step, self.offset = bundle.opacity, bundle.step, bundle.offset
        self.sees_curvature, self.curvature = bundle.sees_curvature, bundle.curvature
        names = ("opacity", "offset", "reflectance")
        self.levels = [Levels([a[f"{name}/texture/{i}"] for i in range(self.last + 1)]) for name in names]
        self.networks = [network(a, f"{name}/hidden", f"{name}/last") for name in names]

    def eval_opacity(self, u, radius, w, kappa):
        """α, and the features for `rho`, a list of floats; neither depends on the light."""
        level = level_of(radius, self.texels, self.last)
        kappa = self._curvature(kappa)
        inputs = [w.x, w.y, w.z, kappa]
        alpha = mi.Float(1)
        if self.opacity != "none":
            (x,) = self._answer(0, [*self._features(0, u, level), *inputs])
            alpha = _sigmoid((w.z - _sigmoid(x - 4)) / self.step) if self.opacity == "cosine" else _sigmoid(x)
        (way,) = self._answer(1, [*self._features(1, u, level), *inputs])
        return alpha, self._features(2, u - self.offset * way * mi.Point2f(w.x, w.y), level)

    def rho(self, features, w, light, kappa):
        """ρ(ω, ω′)."""
        raw = self._answer(2, [*features, w.x, w.y, w.z, light.x, light.y, light.z, self._curvature(kappa)])
        return mi.Color3f(*(softplus(y - 2) for y in raw))

    def _curvature(self, kappa):
        if not self.sees_curvature:
            return mi.Float(0)
        low, high = self.curvature
        return (2 * dr.clip(kappa, low, high) - low - high) / (high - low)

    def _features(self, k, u, level):
        def at(l):
            height, width = self.levels[k].size(l)
            x, y = (u.x - dr.floor(u.x)) * mi.Float(width) - 0.5, (u.y - dr.floor(u.y)) * mi.Float(height) - 0.5
            return self.levels[k].bilinear(x, y, l, True)

        return between_levels(level, self.last, at)

    def _answer(self, k, inputs):
        hidden, last = self.networks[k]
        x = nn.CoopVec(*inputs)
        for weight, bias in hidden:
            x = dr.maximum(nn.matvec(weight, x, bias), 0)
        return list(nn.matvec(last[0], x, last[1]))


@dataclass
class Met:
    """A segment's hit on a surface material: whether there is one, its distance, whether from outside, the face's normal; α, ω,
    κ, the frame as rows of J⁻¹ (other fields of IntervalFrame are unset), the material's index, and features for `rho`."""

    hit: mi.Bool
    t: mi.Float
    front: mi.Bool
    normal: mi.Vector3f
    alpha: mi.Float
    w: mi.Vector3f
    kappa: mi.Float
    frame: IntervalFrame
    which: mi.UInt32
    features: list


class SurfaceMeshes:
    """Meshes as tables, and the material of each."""

    def __init__(self, tables: list[SurfaceTables], materials: list[SurfaceMaterial]):
        self.materials = list(dict.fromkeys(materials))
        self.channels = max(m.levels[2].width for m in self.materials)
        counts = [len(t.mesh.faces) for t in tables]
        first = np.cumsum([0, *(len(t.mesh.vertices) for t in tables[:-1])])
        faces = np.concatenate([t.mesh.faces + a for t, a in zip(tables, first, strict=True)])
        triangles = np.concatenate([t.mesh.vertices[t.mesh.faces].astype(np.float64) for t in tables])
        outward = _unit(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]))
        self.size = dr.opaque(mi.Float, float(np.ptp(triangles.reshape(-1, 3), axis=0).max()))
        self.directions = tables[0].table.kappa.shape[1]
        self.faces = _flat(faces, mi.UInt32)
        self.outward = _flat(outward)
        self.uv = _flat(np.concatenate([t.uv for t in tables]))
        self.normals = _flat(np.concatenate([t.mesh.normals for t in tables]))
        self.along = [_flat(_unit(np.concatenate([getattr(t, k) for t in tables]))) for k in ("along_u", "along_v")]
        self.kappa = _flat(np.concatenate([t.table.kappa * t.period for t in tables]))
        self.axes = [_flat(np.concatenate([getattr(t.table, k) for t in tables])) for k in ("tangent", "bitangent")]
        self.period = _flat(np.repeat([t.period for t in tables], counts))
        self.which = _flat(np.repeat([self.materials.index(m) for m in materials], counts), mi.UInt32)
        centre = triangles.mean(axis=(0, 1))  # rays are met in float32: keep its numbers small
        self.centre = mi.Vector3d(*(dr.opaque(mi.Float64, float(x)) for x in centre))
        self.scene = scene_of(triangles - centre)

    def meet(self, ray, active):
        """The first hit of a segment, before its end."""
        o, d = mi.Point3f(ray.o - self.centre), mi.Vector3f(ray.d)
        nearest = self.scene.ray_intersect_preliminary(mi.Ray3f(o, d), coherent=mi.Bool(False), active=active)
        hit = active & nearest.is_valid() & (mi.Float64(nearest.t) < ray.tmax)
        prim = dr.select(hit, nearest.prim_index, 0)
        bary = [1 - nearest.prim_uv.x - nearest.prim_uv.y, nearest.prim_uv.x, nearest.prim_uv.y]
        corner = dr.gather(mi.Vector3u, self.faces, prim)
        corners = [corner.x, corner.y, corner.z]
        normal = dr.gather(mi.Vector3f, self.outward, prim)
        front: Any = dr.dot(normal, d) < 0
        frame = self._frame(prim, corners, bary)
        w = mi.Vector3f(-dr.dot(frame.a, d), -dr.dot(frame.b, d), -dr.dot(frame.c, d))
        w.z = dr.maximum(w.z, MIN_COSINE)
        w = dr.normalize(w)
        uv = [dr.gather(mi.Point2f, self.uv, prim * 3 + k) for k in range(3)]
        u = bary[0] * uv[0] + bary[1] * uv[1] + bary[2] * uv[2]
        kappa = self._curvature(corners, bary, d)
        radius = 0.5 * ray.spread * (nearest.t + ray.apex) / dr.gather(mi.Float, self.period, prim)
        which = dr.gather(mi.UInt32, self.which, prim)

        def eval_opacity(m):
            alpha, features = m.eval_opacity(u, radius, w, kappa)
            return alpha, [*features, *(mi.Float(0) for _ in range(self.channels - len(features)))]

        alpha, features = self._choose(which, eval_opacity, (mi.Float(0), [mi.Float(0) for _ in range(self.channels)]))
        return Met(hit, mi.Float(nearest.t), front, normal, alpha, w, kappa, frame, which, features)

    def rho(self, met: Met, lights):
        """ρ toward each of some directions of the frame."""

        def one(m):
            features = met.features[: m.levels[2].width]
            return [m.rho(features, met.w, light, met.kappa) for light in lights]

        return self._choose(met.which, one, [mi.Color3f(0) for _ in lights])

    def beyond(self, t):
        """The distance from which a ray goes on past its hit at t."""
        return t + ADVANCE * (self.size + t)

    def _frame(self, prim, corners, bary) -> IntervalFrame:
        normals = [dr.gather(mi.Vector3f, self.normals, c) for c in corners]
        n = dr.normalize(bary[0] * normals[0] + bary[1] * normals[1] + bary[2] * normals[2])
        along_u, along_v = (dr.gather(mi.Vector3f, x, prim) for x in self.along)
        t = along_u - dr.dot(along_u, n) * n
        t = dr.select(dr.squared_norm(t) > 1e-24, t, mi.coordinate_system(n)[0])
        t = dr.normalize(t)
        b = dr.cross(n, t)
        b = dr.select(dr.dot(b, along_v) < 0, -b, b)
        frame = no_frame()
        frame.a, frame.b, frame.c = t, b, n
        return frame

    def _curvature(self, corners, bary, d):
        """κ along d (geometry/curvature.lookup)."""
        total = mi.Float(0)
        for c, weight in zip(corners, bary, strict=True):
            x, y = (dr.dot(dr.gather(mi.Vector3f, axis, c), d) for axis in self.axes)
            angle = dr.atan2(y, x) * (self.directions / dr.pi)
            low = dr.floor(angle)
            share, j = angle - low, mi.Int32(low) + 2 * self.directions
            before, after = (
                dr.gather(mi.Float, self.kappa, c * self.directions + mi.UInt32(i % self.directions))
                for i in (j, j + 1)
            )
            total += weight * (before + share * (after - before))
        return total

    def _choose(self, which, what, nothing):
        if len(self.materials) == 1:
            return what(self.materials[0])
        for i, material in enumerate(self.materials):
            nothing = dr.if_stmt(
                (nothing, which), which == i, lambda x, w, m=material: (what(m), w), lambda x, w: (x, w)
            )[0]
        return nothing


def nothing_met(n: int) -> Met:
    """The result for rays without a hit."""
    zero = dr.zeros(mi.Float, n)
    no = dr.full(mi.Bool, False, n)
    nowhere = mi.Vector3f(0), mi.Float(zero), no_frame()
    return Met(no, zero, no, mi.Vector3f(0), mi.Float(zero), *nowhere, mi.UInt32(0), [])


def draw_around(frame, xi):
    """A world direction, the same in the frame, and its density, 1/sr. xi: two uniform numbers."""
    z = dr.sqrt(4 * BELOW * xi.x + (BELOW - 1) ** 2) - BELOW
    phi = 2 * dr.pi * xi.y
    r = dr.sqrt(dr.maximum(1 - z * z, 0))
    local = mi.Vector3f(r * dr.cos(phi), r * dr.sin(phi), z)
    d = local.x * frame.a + local.y * frame.b + local.z * frame.c
    return d, local, density_around(frame, d)


def density_around(frame, d):
    """Density with which `draw_around` draws a world direction."""
    return mi.Float(dr.maximum(dr.dot(frame.c, d) + BELOW, 0)) / (4 * dr.pi * BELOW)


def _flat(x: np.ndarray, kind: type = mi.Float):
    return kind(np.ascontiguousarray(x).astype(np.uint32 if kind is mi.UInt32 else np.float32).ravel())


def _unit(x: np.ndarray) -> np.ndarray:
    """Rows of length 1, or 0: squares of longer ones may overflow float32."""
    size = np.linalg.norm(x, axis=1, keepdims=True)
    return x / np.where(size > 0, size, 1)


def _sigmoid(x):
    return dr.rcp(1 + dr.exp(-x))
