"""Pictures of a mesh with a surface material: one query per hit, in place of a march.

Notation
α, ρ         opacity and reflectance of a hit (surface_material/network)
T            transmittance of the hits before
L, E         a light's direction and irradiance on the plane facing it                                       (render/light)
V            transmittance of the material from the hit to a light

A ray adds T α Σ ρ E V at each hit from outside, goes on with T (1 − α), and passes from within. Light from below the horizon of
a hit passes the body's other side unhindered: ρ accounts for the body in its way.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.geometry.albedo import Albedo
from mesoshell.geometry.convex import is_convex
from mesoshell.geometry.enclosure import enclosure
from mesoshell.nets.batches import run
from mesoshell.nets.mlp import in_tiles
from mesoshell.render.camera import pixel_radius
from mesoshell.render.effects import SURFACE, Effects, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.render.light import Beam, beams, lookup
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import Draws
from mesoshell.render.tiles import RenderReport, TileRenderer, render_tiles
from mesoshell.surface_material.intersector import ADVANCE, Hits, Local, SurfaceIntersector
from mesoshell.surface_material.loader import DeviceMaterial
from mesoshell.surface_material.network import BlurredSurface, SurfaceConfig, SurfaceQuery, eval_opacity, reflectance
from mesoshell.surface_material.scene import SurfaceDescription
from mesoshell.surface_material.tables import surface_tables
from mesoshell.typing import Array

#: Rays of a tile of the picture; most surfaces that a ray or a shadow passes (rays that would pass more are counted).
RAYS, MAX_SURFACES = 32768, 1024


@dataclass(frozen=True, eq=False)
class SurfaceScene(SurfaceDescription):
    """A mesh to render, with its material and lights."""

    device_material: DeviceMaterial = field(kw_only=True)


def facts(scene: SurfaceScene) -> Facts:
    """Facts for planning the effects."""
    convex = is_convex(scene.mesh)
    return Facts(
        surfaces=1,
        objects=len(scene.objects),
        distant=len(scene.lights),
        environment=scene.environment is not None,
        seen=not scene.transparent,
        convex=convex,
        enclosed=0.0 if convex and not scene.objects else enclosure((scene.mesh, *scene.objects)),
        passable=scene.device_material.config.opacity != "none",
    )


def plan(scene: SurfaceScene, quality: Quality) -> Effects:
    """Decide each effect."""
    return plan_effects(facts(scene), quality, SURFACE)


def render(
    scene: SurfaceScene,
    quality: Quality,
    effects: Effects,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Float[np.ndarray, "H W 4"], RenderReport]:
    """Linear RGBA, premultiplied, and a report. progress: called with the share done, 0 to 1."""
    report, begin = RenderReport(), time.perf_counter()
    tile = tile_renderer(scene, quality, effects, report)
    image = render_tiles(scene.camera, quality.pixel_samples, RAYS, tile, progress)
    report.time("wall", begin)
    report.notes += cut_short(report)
    return image, report


def tile_renderer(scene: SurfaceScene, quality: Quality, effects: Effects, report: RenderReport) -> TileRenderer:
    """What renders tiles of rays of a scene, and adds to the report."""
    begin = time.perf_counter()
    others = [m.vertices[m.faces].astype(np.float64) for m in scene.objects]
    intersector = SurfaceIntersector(
        surface_tables(scene.mesh, scene.period, quality), np.concatenate([np.zeros((0, 3, 3)), *others])
    )
    report.notes = intersector.tables.notes(scene.device_material.curvature)
    report.time("prepare", begin)

    def tile(o: np.ndarray, d: np.ndarray, shift: float, draws: Draws, check: Callable[[], None]) -> np.ndarray:
        return _Tile(scene, intersector, quality, effects, report, check).rgba(o, d, draws)

    return tile


def cut_short(report: RenderReport) -> tuple[str, ...]:
    """What the user should know of rays that passed too many surfaces."""
    cut = report.counts.get("cut_short")
    return (
        (f"{cut} rays and shadows passed {MAX_SURFACES} surfaces; whatever lies behind these was left out",)
        if cut
        else ()
    )


class _Tile:
    """Rays that are rendered together."""

    def __init__(
        self,
        scene: SurfaceScene,
        intersector: SurfaceIntersector,
        quality: Quality,
        effects: Effects,
        report: RenderReport,
        check: Callable[[], None],
    ):
        self.scene, self.intersector, self.quality = scene, intersector, quality
        self.effects, self.report, self.check = effects, report, check
        self.spread = pixel_radius(scene.camera.spread) / 2
        self.albedo = Albedo(intersector.count, scene.objects, scene.base_colour)

    def rgba(self, o: np.ndarray, d: np.ndarray, draws: Draws) -> Float[np.ndarray, "R 4"]:
        """Premultiplied."""
        count = len(o)
        sky = self.scene.environment if self.effects.environment.on else None
        lights = beams(self.scene.lights, sky, self.quality.environment_samples, draws)
        rgb, through, start = np.zeros((count, 3)), np.ones(count), np.zeros(count)
        alive = np.arange(count)
        for _ in range(MAX_SURFACES):
            self.check()
            clock = time.perf_counter()
            hits = self.intersector.meet(o[alive] + start[alive, None] * d[alive], d[alive])
            self.report.time("trace", clock, rays=len(alive))
            met = hits.face >= 0
            start[alive] += np.where(met, hits.t + ADVANCE * (self.intersector.size + hits.t), 0)
            ours = np.flatnonzero(met & hits.front & (hits.face < self.intersector.count))
            other = np.flatnonzero(hits.face >= self.intersector.count)
            for rows, shade in ((ours, self._material), (other, self._diffuse)):
                ray = alive[rows]
                alpha, light = shade(hits, rows, (o[ray], d[ray], start[ray]), _some(lights, ray))
                rgb[ray] += (through[ray] * alpha)[:, None] * light
                through[ray] *= 1 - alpha
            alive = alive[met & (through[alive] > self.quality.early_stop)]
            if not len(alive):
                break
        self.report.count(cut_short=len(alive))
        alpha = 1 - through
        if self.effects.background.on and self.scene.environment is not None:
            rgb += through[:, None] * lookup(self.scene.environment, d)
            alpha = np.ones(count)
        return np.concatenate([rgb, alpha[:, None]], axis=1)

    def _material(self, hits: Hits, rows: np.ndarray, ray: tuple, lights: list[Beam]) -> tuple[np.ndarray, np.ndarray]:
        """α of hits, and the radiance that they reflect."""
        o, d, t = ray
        clock = time.perf_counter()
        local = self.intersector.queries(hits, rows, d, self.spread * t)
        if not lights:
            alpha = _opacity(self.scene.device_material, local)
            self.report.time("query", clock, queries=len(rows))
            return alpha, np.zeros((len(rows), 3))
        toward = [np.einsum("hij,hj->hi", local.axes, beam.toward) for beam in lights]
        alpha, rho = _answered(self.scene.device_material, local, np.stack(toward, axis=1))
        normal = self.intersector.facing(hits, rows, d)
        self.report.time("query", clock, queries=len(rows), transport_queries=len(rows) * len(lights))
        out = np.zeros((len(rows), 3))
        for k, beam in enumerate(lights):
            out += rho[:, k] * beam.strength * self._visible(o, d, t, normal, beam.toward)[:, None]
        return alpha, out

    def _diffuse(self, hits: Hits, rows: np.ndarray, ray: tuple, lights: list[Beam]) -> tuple[np.ndarray, np.ndarray]:
        """The same for other objects."""
        o, d, t = ray
        normal = self.intersector.facing(hits, rows, d)
        slant = np.abs(np.einsum("ij,ij->i", normal, d))
        albedo = self.albedo.at(hits.face[rows], hits.bary[rows, :2], self.scene.camera.spread * t, slant)
        out = np.zeros((len(rows), 3))
        for beam in lights:
            cosine = np.maximum(np.einsum("ij,ij->i", normal, beam.toward), 0)
            visibility = self._visible(o, d, t, normal, beam.toward)
            out += (cosine * visibility)[:, None] * beam.strength * albedo / np.pi
        return np.ones(len(rows)), out

    def _visible(self, o, d, t, normal, toward) -> Float[np.ndarray, "H"]:
        """V from hits at t toward a light. normal: of the face, not interpolated: light above the horizon of an interpolated
        normal may still have to pass the face itself."""
        through = np.ones(len(t))
        if not (self.effects.mesh_shadow.on or self.effects.object_shadow.on) or not len(t):
            return through
        clock = time.perf_counter()
        away = 4 * ADVANCE * (self.intersector.size + t) * np.where(np.einsum("ij,ij->i", normal, toward) < 0, -1, 1)
        x, start, alive = o + t[:, None] * d + away[:, None] * normal, np.zeros(len(t)), np.arange(len(t))
        queries = 0
        for _ in range(MAX_SURFACES):
            self.check()
            hits = self.intersector.meet(x[alive] + start[alive, None] * toward[alive], toward[alive])
            met = hits.face >= 0
            start[alive] += np.where(met, hits.t + ADVANCE * (self.intersector.size + hits.t), 0)
            through[alive[hits.face >= self.intersector.count]] = 0
            rows = np.flatnonzero(met & hits.front & (hits.face < self.intersector.count))
            ray = alive[rows]
            if self.effects.opacity.on:
                local = self.intersector.queries(hits, rows, toward[ray], self.spread * t[ray])
                alpha = _opacity(self.scene.device_material, local)
                queries += len(rows)
            else:
                alpha = np.ones(len(rows))
            through[ray] *= 1 - alpha
            alive = alive[met & (through[alive] > self.quality.early_stop)]
            if not len(alive):
                break
        self.report.time("shadow", clock, shadow_rays=len(t), opacity_queries=queries, cut_short=len(alive))
        return through


def _some(lights: list[Beam], rows: np.ndarray) -> list[Beam]:
    return [Beam(beam.toward[rows], beam.strength[rows]) for beam in lights]


def _opacity(device_material: DeviceMaterial, local: Local) -> Float[np.ndarray, "H"]:
    """α."""
    return run(
        lambda *x: _ask_opacity(device_material.config, device_material.table, x[:-1], x[-1]),
        *_rows(device_material, local),
    ).astype(np.float64)


def _answered(
    device_material: DeviceMaterial, local: Local, light: Float[np.ndarray, "H L 3"]
) -> tuple[np.ndarray, np.ndarray]:
    """α (H,) and ρ (H, L, 3); at least one light."""
    rows = (*_rows(device_material, local), light.astype(np.float32))
    alpha, rho = run(lambda *x: _ask(device_material.config, device_material.table, x[:-1], x[-1]), *rows)
    return alpha.astype(np.float64), rho.reshape(light.shape).astype(np.float64)


def _rows(device_material: DeviceMaterial, local: Local) -> tuple[np.ndarray, ...]:
    low, high = device_material.curvature
    kappa = (2 * np.clip(local.kappa, low, high) - low - high) / (high - low)
    return tuple(np.asarray(x, np.float32) for x in (local.u, local.radius, local.w, kappa))


@partial(jax.jit, static_argnums=0)
def _ask_opacity(config: SurfaceConfig, table: BlurredSurface, rows: tuple[Array, ...], count: Array) -> Array:
    alpha = jax.vmap(lambda *x: eval_opacity(config, table, SurfaceQuery(*x)).alpha)
    return in_tiles(lambda *x: (alpha(*x),), count, rows, ((0, jnp.float32),))[0]


@partial(jax.jit, static_argnums=0)
def _ask(config: SurfaceConfig, table: BlurredSurface, rows: tuple[Array, ...], count: Array) -> tuple[Array, Array]:
    def one(u: Array, radius: Array, w: Array, kappa: Array, light: Array) -> tuple[Array, Array]:
        place = SurfaceQuery(u, radius, w, kappa)
        opacity = eval_opacity(config, table, place)
        return opacity.alpha, jax.vmap(lambda l: reflectance(config, table, place, opacity, l))(light).reshape(-1)

    return in_tiles(jax.vmap(one), count, rows, ((0, jnp.float32), (3 * rows[-1].shape[1], jnp.float32)))
