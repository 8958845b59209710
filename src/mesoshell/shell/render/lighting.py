"""Light on a tile of rays: what the shell scatters, and what the surfaces under and beside it reflect.

Notation
L           unit vector toward a light                                         (3,), world
E           E⊥ of a distant light, or radiance / p of a drawn direction          RGB
V           visibility, 0 or 1: from the exit point on the shell's top toward L; only surfaces block, since ρ holds the
            shell's own shadow
ξ(s)        (u, v, 0) + s ω′ / ω′_z: the way from the surface to the light through a locally flat shell (MesoGAN,
            section 4.2.1, assumes the same of ρ)

The scattered sum is Σ w ρ(ω, ω′) E V, with no cosine. Surfaces are diffuse: albedo / π · cos⁺ · E · V · T_shell.
"""

import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mesoshell.geometry.albedo import Albedo
from mesoshell.nets.batches import CAPACITY, run
from mesoshell.nets.mlp import in_tiles
from mesoshell.render.effects import Effects
from mesoshell.render.light import Beam, beams
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import Draws
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.extrude import FLATTEST
from mesoshell.shell.geometry.sampling import Chart, Frame, Piece, inverse_jacobian
from mesoshell.shell.geometry.tracer import ADVANCE, Boundary, Trace
from mesoshell.shell.render import kernels
from mesoshell.shell.render.media import Decoding, Media
from mesoshell.shell.render.scene import Scene
from mesoshell.typing import Array


class Shaded(NamedTuple):
    """Samples to light: row of the interval, position on it (0 to 1), ray, weight, ρ toward each light."""

    row: Int[np.ndarray, "S"]
    f: Float[np.ndarray, "S"]
    ray: Int[np.ndarray, "S"]
    weight: Float[np.ndarray, "S"]
    rho: Float[np.ndarray, "S L 3"]


class Tile(NamedTuple):
    """Rays that are rendered together, and the lights as each of them sees them."""

    o: Float[np.ndarray, "R 3"]
    d: Float[np.ndarray, "R 3"]
    beams: list[Beam]


class Lighting:
    """Evaluates light for one scene; each method serves one tile of rays."""

    def __init__(
        self,
        scene: Scene,
        quality: Quality,
        effects: Effects,
        boundary: Boundary,
        media: Media,
        report,
    ):
        self.scene, self.quality, self.effects, self.boundary = scene, quality, effects, boundary
        self.media, self.report = media, report
        self.shadows = effects.mesh_shadow.on or effects.object_shadow.on
        others = [m.vertices[m.faces] for m in scene.objects]
        corners = np.concatenate([scene.mesh.vertices[scene.mesh.faces], *others]).astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.face_normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        self.albedo = Albedo(len(scene.mesh.faces), scene.objects, scene.base_colour)
        self.stands = np.full(len(corners), -1)
        self.stands[scene.shell.mesh_face] = np.arange(len(scene.shell.mesh_face))
        self.uv_of_face = scene.shell.uv

    def beams(self, draws: Draws) -> list[Beam]:
        """Every distant light, and each drawn direction of the environment as a light of its own."""
        sky = self.scene.environment if self.effects.environment.on else None
        return beams(self.scene.lights, sky, self.quality.environment_samples, draws)

    def transport(
        self,
        tile: Tile,
        medium: Decoding,
        features: Array,
        where: np.ndarray,
        row: np.ndarray,
        ray: np.ndarray,
        pieces: Piece,
        at: Frame,
    ) -> Float[np.ndarray, "S L 3"]:
        """ρ of a material's samples toward every light. features: trunk features on the device, where: the samples' rows in
        them."""
        toward = np.stack([beam.toward[ray] for beam in tile.beams], axis=1).astype(np.float32)
        self.report.count(transport_queries=len(row) * len(tile.beams))
        return run(
            lambda k, r, w, n: kernels.transport(medium.table, at, pieces, features, k, r, w, n),
            where.astype(np.int32),
            row,
            toward,
        )

    def shell(self, tile: Tile, i: Intervals, s: Shaded, at: Frame) -> Float[np.ndarray, "R 3"]:
        """What the shell scatters toward each ray."""
        clock = time.perf_counter()
        o, d = tile.o, tile.d
        rgb = np.zeros((len(o), 3))
        if not len(s.row):
            return rgb
        used, back = np.unique(s.row, return_inverse=True)
        f = np.full(len(used), 0.5)
        if self.quality.visibility == "sample":
            used, back, f = s.row, np.arange(len(s.row)), s.f
        inverse = np.asarray(at.inverse)[used]
        t = (1 - f) * i.t0[used] + f * i.t1[used]
        x = o[i.ray[used]] + t[:, None] * d[i.ray[used]]
        height = (1 - f) * i.h0[used] + f * i.h1[used]
        lit = np.zeros((len(s.row), 3), np.float32)
        for k, beam in enumerate(tile.beams):
            add = s.rho[:, k] * beam.strength[s.ray].astype(np.float32)
            if self.shadows:
                toward = beam.toward[i.ray[used]]
                rate = np.einsum("ij,ij->i", inverse[:, 2], toward)
                flattest = np.maximum(FLATTEST * np.linalg.norm(inverse[:, 2], axis=1), 1e-30)
                leave = np.where(rate > 0, (1 - height) / np.maximum(rate, flattest), 0)
                leave = np.minimum(leave, self.boundary.size) + ADVANCE * self.boundary.size
                seen = ~self.boundary.occluded(x + leave[:, None] * toward, toward)
                self.report.count(shadow_rays=len(used))
                add *= seen[back, None]
            lit += add
        for c in range(3):
            rgb[:, c] = np.bincount(s.ray, s.weight * lit[:, c], len(o))
        self.report.time("light", clock)
        return rgb

    def surfaces(self, tile: Tile, traced: Trace, through: Float[np.ndarray, "R"]) -> Float[np.ndarray, "R 3"]:
        """What the surface at each ray's end reflects toward it; 0 without a surface, or where the shell hides it."""
        clock = time.perf_counter()
        o, d = tile.o, tile.d
        rgb = np.zeros((len(o), 3))
        hit = np.flatnonzero((traced.face >= 0) & (through > self.quality.least_weight))
        if not len(hit) or not tile.beams:
            return rgb
        face = traced.face[hit]
        normal = self.face_normal[face]
        normal = np.where(np.einsum("ij,ij->i", normal, d[hit])[:, None] > 0, -normal, normal)
        x = o[hit] + traced.end[hit, None] * d[hit] + 2 * ADVANCE * self.boundary.size * normal
        parts = []
        for beam in tile.beams:
            toward = beam.toward[hit]
            cosine = np.maximum(np.einsum("ij,ij->i", normal, toward), 0)
            seen = ~self.boundary.occluded(x, toward) if self.shadows else np.ones(len(hit), bool)
            lit = np.flatnonzero((cosine > 0) & seen)
            parts.append((lit, toward[lit], cosine[lit, None] * beam.strength[hit[lit]]))
        lit, toward, strength = (np.concatenate(x) for x in zip(*parts, strict=True))
        for first in range(0, len(lit), CAPACITY):
            some = slice(first, first + CAPACITY)
            strength[some] *= self.transmitted(face[lit[some]], traced.bary[hit[lit[some]]], toward[some])[:, None]
        for c in range(3):
            rgb[hit, c] = np.bincount(lit, strength[:, c], len(hit))
        slant = np.abs(np.einsum("ij,ij->i", normal, d[hit]))
        pixel = self.scene.camera.spread * traced.end[hit]
        rgb[hit] *= self.albedo.at(face, traced.bary[hit], pixel, slant) / np.pi
        self.report.time("surfaces", clock)
        return rgb

    def transmitted(self, face: np.ndarray, bary: np.ndarray, toward: np.ndarray) -> Float[np.ndarray, "H"]:
        """T_shell from a point on the base toward a light; 1 where no shell stands on the face."""
        out = np.ones(len(face))
        prism = self.stands[face]
        under = np.flatnonzero(prism >= 0)
        if not len(under):
            return out
        prism, bary = prism[under], bary[under].astype(np.float32)
        inverse = np.asarray(jacobians(self.media.chart, prism, bary))
        w = np.einsum("ijk,ik->ij", inverse, toward[under])
        w /= np.maximum(np.linalg.norm(w, axis=1, keepdims=True), 1e-30)
        up = np.maximum(w[:, 2], 0.05)  # a grazing light crosses at most 20 heights
        n = self.quality.base_samples
        weights = np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
        uv = np.einsum("ik,ikc->ic", weights, self.uv_of_face[prism])
        h = (np.arange(n) + 0.5) / n
        xi = np.empty((len(under), n, 3), np.float32)
        xi[..., :2] = uv[:, None] + (h[None, :, None] / up[:, None, None]) * w[:, None, :2]
        xi[..., 2] = h
        sigma = np.empty((len(under), n), np.float32)
        for medium, own in self.media.parts(prism):
            radius = np.full(len(own) * n, 0.5 / medium.program.layout.texel_density, np.float32)
            reads = medium.program.baked is not None
            self.report.count(**{"grid_reads" if reads else "surface_queries": len(own) * n})
            sigma[own] = run(
                lambda x, r, c, m=medium: kernels.density_at(*m, x, r, c), xi[own].reshape(-1, 3), radius
            ).reshape(-1, n)
        out[under] = np.exp(-sigma.mean(axis=1) / up) * (w[:, 2] > 0)
        return out


def jacobians(chart: Chart, prism: np.ndarray, bary: np.ndarray) -> np.ndarray:
    """J⁻¹ on the base surface of many prisms."""
    return run(lambda p, b, n: _jacobians(chart, p, b, n), prism.astype(np.int32), bary).reshape(-1, 3, 3)


@jax.jit
def _jacobians(chart: Chart, prism: Array, bary: Array, count: Array) -> Array:
    def tile(prism: Array, bary: Array) -> tuple[Array]:
        inverse = jax.vmap(lambda p, b: inverse_jacobian(chart, p, b, jnp.zeros((), jnp.float32)))(prism, bary)
        return (inverse.reshape(-1, 9),)

    return in_tiles(tile, count, (prism, bary), ((9, jnp.float32),))[0]
