"""Render a scene: trace, sample, skip, decode front to back, light, composite.

Notation
R, I, S     rays, intervals, samples of one tile of rays
τ, T, w     optical depth of a sample, transmittance before it, its weight T (1 − e^{−τ})
ρ           transport; a sample adds w ρ E⊥ for each light that its interval sees
K, c, u     samples to light, drawn: c of the opacities (k + u)/K, k = 0, 1, …, lie in a sample, which then has the weight c/K:
            in the mean over u in [0, 1) its w. K is `light_samples` over the opacity expected of the ray

Work is compacted at every stage: rays that meet nothing make no intervals, samples in empty space (by the bundle's σ grid)
are not decoded, rays whose transmittance has fallen below `early_stop` get no further wave of samples, and lighting skips
samples whose weight is below `Quality.least_weight`, or takes `Quality.light_samples` a ray. Where density is baked, the
network is asked for lit samples alone. Image tiles bound the memory, whatever the image's size.
"""

import time
from collections.abc import Callable, Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.kept import kept
from mesoshell.nets.batches import CAPACITY, batches, capacity, pad, run
from mesoshell.render.effects import Effects
from mesoshell.render.light import lookup
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import Draws, draws_at
from mesoshell.render.tiles import RenderReport, TileRenderer, render_tiles
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.march import table
from mesoshell.shell.geometry.sampling import Chart, Frame, Piece, spread
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render import kernels
from mesoshell.shell.render.compile_ahead import compile_ahead
from mesoshell.shell.render.kernels import Samples
from mesoshell.shell.render.lighting import Lighting, Shaded, Tile
from mesoshell.shell.render.media import Decoded, Decoding, Media
from mesoshell.shell.render.scene import Scene
from mesoshell.shell.render.spacing import Candidates, by_density, even
from mesoshell.typing import Array

#: Most rays of a tile of the image, and bytes of what all its samples reflect; samples a ray and wave, and of a wave that reads
#: a grid.
RAYS, BYTES, WAVE, BAKED_WAVE = 32768, 2**29, 8, 64
#: Intervals of a ray for which a tile has rows from the start.
USUAL = 8
#: Least opacity that is expected of a ray.
MIN_OPACITY = 1e-3


def render(
    scene: Scene, quality: Quality, effects: Effects, progress: Callable[[float], None] = lambda share: None
) -> tuple[Float[np.ndarray, "H W 4"], RenderReport]:
    """Linear RGBA, premultiplied, (H, W, 4), and a report. progress: called with the share done, 0 to 1."""
    report, begin = RenderReport(), time.perf_counter()
    renderer = _Renderer(scene, quality, effects, report)
    if scene.camera.width * scene.camera.height * quality.pixel_samples > renderer.most:
        renderer.compile()
    image = render_tiles(scene.camera, quality.pixel_samples, renderer.most, renderer.tile, progress)
    report.time("wall", begin)
    return image, report


def marched_tile(
    scene: Scene, quality: Quality, effects: Effects, report: RenderReport
) -> tuple[TileRenderer, int, Callable[[], None]]:
    """What renders tiles of rays of a scene, and adds to the report; most rays of a tile; and what compiles all that it may
    call."""
    renderer = _Renderer(scene, quality, effects, report)
    return renderer.tile, renderer.most, renderer.compile


def rays_a_tile(samples: int, lights: int) -> int:
    """Most rays of a tile whose rays have so many samples, each lit by so many lights."""
    return max(1, min(RAYS, BYTES // (12 * samples * max(lights, 1))))


@kept
def _tables(shell: Shell, mesh: Mesh, objects: tuple[Mesh, ...]) -> tuple[Boundary, Chart]:
    """What rays are traced through, and its chart."""
    boundary = Boundary(shell, mesh.faces, others=object_triangles(objects))
    corners = jnp.asarray(np.asarray(boundary.prisms.corners))
    return boundary, Chart(corners, jnp.asarray(table(shell.uv.reshape(-1, 6), np.float32)))


class _Renderer:
    """A scene's tables, ready for tiles of rays."""

    def __init__(self, scene: Scene, quality: Quality, effects: Effects, report: RenderReport):
        begin = time.perf_counter()
        self.scene, self.quality, self.effects, self.report = scene, quality, effects, report
        shell = scene.shell
        self.boundary, chart = _tables(shell, scene.mesh, scene.objects)
        self.third = shell.base[shell.faces[:, 2]].astype(np.float64)
        begin = report.time("prepare", begin)
        self.media = Media(scene, quality, effects, chart)
        begin = report.time("bake", begin) if effects.baked_density.on else begin
        self.lighting = Lighting(scene, quality, effects, self.boundary, self.media, report)
        self.lights = len(self.lighting.beams(draws_at(np.zeros((1, 2)), 0.0)))
        self.most = rays_a_tile(quality.samples, self.lights)
        self.rows = capacity(USUAL * min(self.most, scene.camera.width * scene.camera.height))
        report.time("prepare", begin)

    def compile(self) -> None:
        """Compile what tiles call."""
        begin = time.perf_counter()
        compile_ahead(self.media.each, self.boundary.prisms, self.quality, self.lights, self.rows)
        self.report.time("compile", begin)

    def tile(
        self,
        o: Float[np.ndarray, "R 3"],
        d: Float[np.ndarray, "R 3"],
        shift: float,
        draws: Draws,
        check: Callable[[], None],
    ) -> Float[np.ndarray, "R 4"]:
        """Premultiplied RGBA of rays (render/tiles)."""
        d = d.astype(np.float32).astype(np.float64)
        clock = time.perf_counter()
        traced = self.boundary.trace(o, d)
        clock = self.report.time("trace", clock)
        check()
        self.report.count(rays=len(o), visits=traced.walked, visits_in_float64=traced.redone)
        i = traced.intervals
        self.report.count(intervals=len(i.ray))
        pieces, at = self.frames(i, o, d)
        candidates = self.candidates(i, pieces, at, shift)
        self.report.time("sample", clock)
        lit = Tile(o, d, self.lighting.beams(draws))
        drawn = draws.numbers() if self.quality.light_samples else None
        depth, shaded = self.march(candidates, pieces, at, lit, drawn, check)
        rgb = self.lighting.shell(lit, i, shaded, at)
        through = np.exp(-depth)
        solid = np.isfinite(traced.end)
        cut = (traced.face >= len(self.scene.mesh.faces)) if self.scene.holdout else np.zeros(len(o), bool)
        rgb += (through * ~cut)[:, None] * self.lighting.surfaces(lit, traced, through)
        clock = time.perf_counter()
        alpha = np.where(solid & ~cut, 1.0, 1 - through)
        if self.effects.background.on and self.scene.environment is not None:
            rgb += (through * ~solid)[:, None] * lookup(self.scene.environment, d)
            alpha = np.where(cut, alpha, 1.0)
        self.report.time("composite", clock)
        return np.concatenate([rgb, alpha[:, None]], axis=1)

    def frames(self, i: Intervals, o: np.ndarray, d: np.ndarray) -> tuple[Piece, Frame]:
        """Rows of the intervals, padded, and their canonical frames."""
        count = max(self.rows, capacity(len(i.ray)))
        self.rows = count
        start = o[i.ray] + i.t0[:, None] * d[i.ray] - self.third[i.prism]
        rows = (
            i.prism,
            np.stack([i.t0, i.t1 - i.t0], axis=1),
            np.stack([i.bary0, i.bary1], axis=1),
            np.stack([i.h0, i.h1], axis=1),
            start,
            d[i.ray],
        )
        padded = Piece(*(jnp.asarray(pad(x if k == 0 else x.astype(np.float32), count)) for k, x in enumerate(rows)))
        return padded, kernels.frames(self.media.chart, padded, np.int32(len(i.ray)))

    def candidates(self, i: Intervals, pieces: Piece, at: Frame, shift: float) -> Candidates:
        """Samples that may hold something."""
        quality, length = self.quality, np.asarray(at.length)[: len(i.ray)]
        if quality.spacing == "density":
            found = by_density(self.media, i, (pieces, at), quality.samples, shift)
            self.report.count(samples=len(found.ray))
            return found
        s = even(spread(i, length, quality.samples, quality.spacing, shift), length)
        self.report.count(samples=len(s.row))
        if quality.skip > 0:
            s = take(s, np.flatnonzero(self.bounds(s, i, pieces, at) > quality.skip))
        return Candidates(s, i.ray[s.row], np.ones(len(s.row)))

    def bounds(self, s: Samples, i: Intervals, pieces: Piece, at: Frame) -> Float[np.ndarray, "S"]:
        """The greatest optical depth that a ray would have if all of it were as dense as each of its samples can be."""
        depth, ray = np.empty(len(s.row), np.float32), i.ray[s.row]
        for medium, own in self.media.parts(i.prism[s.row]):
            depth[own] = run(_kernel(kernels.depth_bounds, medium, pieces, at), *take(s, own))
        return depth * np.bincount(ray, s.step)[ray] / np.maximum(s.step, np.finfo(np.float32).tiny)

    def depths(self, s: Samples, pieces: Piece, at: Frame) -> Float[np.ndarray, "S"]:
        """τ of samples, by the grids."""
        tau, prism = np.empty(len(s.row), np.float32), np.asarray(pieces.prism)
        for medium, own in self.media.parts(prism[s.row]):
            tau[own] = run(_kernel(kernels.baked_depths, medium, pieces, at), *take(s, own))
        return tau

    def decode(self, s: Samples, pieces: Piece, at: Frame) -> tuple[Float[np.ndarray, "S"], list[Decoded]]:
        """τ of samples by the network, and what their batches gave."""
        tau, decoded, prism = np.empty(len(s.row), np.float32), [], np.asarray(pieces.prism)
        for medium, own in self.media.parts(prism[s.row]):
            parts = batches(_kernel(kernels.density, medium, pieces, at), *take(s, own))
            tau[own] = np.concatenate([np.asarray(x) for x, _ in parts])[: len(own)]
            decoded.append(Decoded(medium, own, parts))
        return tau, decoded

    def march(
        self,
        candidates: Candidates,
        pieces: Piece,
        at: Frame,
        tile: Tile,
        drawn: Float[np.ndarray, "R"] | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> tuple[np.ndarray, Shaded]:
        """Decode samples wave by wave, front to back; where density is baked, those to light alone. drawn: u of each ray, if
        samples to light are drawn; check: called before each wave. Returns the rays' optical depths and the samples to
        light."""
        clock = time.perf_counter()
        samples, ray, opacity = candidates
        depth = np.zeros(len(tile.o))
        rank = np.arange(len(ray)) - np.searchsorted(ray, ray)
        stop = -np.log(self.quality.early_stop) if self.quality.early_stop > 0 else np.inf
        none = np.zeros(0, np.int32)
        nothing = np.zeros(0)
        parts = [Shaded(none, nothing, none, nothing, np.zeros((0, len(tile.beams), 3), np.float32))]
        baked = self.effects.baked_density.on
        width = BAKED_WAVE if baked else WAVE
        for wave in range(0, int(rank.max(initial=-1)) + 1, width):
            chosen = np.flatnonzero((rank >= wave) & (rank < wave + width) & (depth[ray] < stop))
            if not len(chosen):
                break
            check()
            some, owner = take(samples, chosen), ray[chosen]
            tau, decoded = (self.depths(some, pieces, at), []) if baked else self.decode(some, pieces, at)
            clock = self.report.time("decode", clock)
            weight, before, depth = accumulate(depth, owner, tau)
            self.report.count(heavy_samples=int((weight > 1e-3).sum()))
            self.report.count(density_queries=0 if baked else len(chosen), grid_reads=len(chosen) if baked else 0)
            least = self.quality.least_weight
            if drawn is not None:
                count = self.quality.light_samples / np.maximum(opacity[chosen], MIN_OPACITY)
                weight, least = draw(before, tau, drawn[owner], count), 0.0
            if tile.beams:
                heavy = weight > least
                if baked:  # its waves are long: a ray stops within one
                    heavy &= before < stop
                lit = self.features(some, heavy, pieces, at) if baked else heavy_batches(decoded, heavy)
                for medium, where, own, features in lit:
                    row, of_ray = some.row[own], owner[own]
                    rho = self.lighting.transport(tile, medium, features, where, row, of_ray, pieces, at)
                    parts.append(Shaded(row, some.f[own], of_ray, weight[own], rho))
            clock = self.report.time("transport", clock)
        return depth, Shaded(*(np.concatenate(c) for c in zip(*parts, strict=True)))

    def features(
        self, s: Samples, heavy: Bool[np.ndarray, "S"], pieces: Piece, at: Frame
    ) -> Iterator[tuple[Decoding, np.ndarray, np.ndarray, Array]]:
        """What `heavy_batches` gives of samples whose density is baked: features of these alone."""
        hot, prism = np.flatnonzero(heavy), np.asarray(pieces.prism)
        self.report.count(density_queries=len(hot))
        for medium, own in self.media.parts(prism[s.row[hot]]):
            for first in range(0, len(own), CAPACITY):
                part = hot[own[first : first + CAPACITY]]
                ((_, features),) = batches(_kernel(kernels.density, medium, pieces, at), *take(s, part))
                yield medium, np.arange(len(part)), part, features


def _kernel(kernel: Callable, medium: Decoding, pieces: Piece, at: Frame) -> Callable:
    return lambda *a: kernel(*medium, pieces, at, Samples(*a[:-1]), a[-1])


def heavy_batches(
    decoded: list[Decoded], heavy: Bool[np.ndarray, "S"]
) -> Iterator[tuple[Decoding, np.ndarray, np.ndarray, Array]]:
    """Of each batch with samples to light: its material, their rows in it, their numbers in the wave, and its features."""
    for medium, own, parts in decoded:
        hot = np.flatnonzero(heavy[own])
        edges = np.searchsorted(hot, np.arange(len(parts) + 1) * CAPACITY)
        for k, (_, features) in enumerate(parts):
            here = hot[edges[k] : edges[k + 1]]
            if len(here):
                yield medium, here - k * CAPACITY, own[here], features


def accumulate(
    depth: Float[np.ndarray, "R"], owner: np.ndarray, tau: Float[np.ndarray, "S"]
) -> tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"], Float[np.ndarray, "R"]]:
    """Weights of samples sorted by ray and distance, given each ray's depth so far; the depths before each; and those of the
    rays after them."""
    capped = np.minimum(tau, 1e3).astype(
        np.float64
    )  # opaque already: more would only cost precision of the next rays' sums
    through = np.cumsum(capped)
    first = np.searchsorted(owner, owner)  # index of the ray's first sample here
    before = depth[owner] + (through - capped) - (through[first] - capped[first])
    after = depth + np.bincount(owner, tau, len(depth))
    return np.exp(-before) * -np.expm1(-tau.astype(np.float64)), before, after


def draw(
    before: Float[np.ndarray, "S"],
    tau: Float[np.ndarray, "S"],
    u: Float[np.ndarray, "S"],
    count: Float[np.ndarray, "S"] | int,
) -> Float[np.ndarray, "S"]:
    """c/K of samples, given the depth before each, and u and K of its ray."""
    first, last = (-count * np.expm1(-x) - u for x in (before, before + tau))
    return (np.ceil(last) - np.ceil(first)) / count


def take(s: Samples, index: np.ndarray) -> Samples:
    """Some of the samples."""
    return Samples(*(x[index] for x in s))


def object_triangles(objects: Sequence[Mesh]) -> np.ndarray:
    """Triangles of the other objects, (F, 3, 3)."""
    parts = [m.vertices[m.faces] for m in objects]
    return np.concatenate(parts) if parts else np.zeros((0, 3, 3), np.float32)
