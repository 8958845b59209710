"""A picture in float64, sample by sample: what the renderer's own pictures are measured against.

The walk, the coordinates (exact, by Newton's method), the filter, the network and the sum over samples are in float64, with
none of the renderer's skipping, early stop, waves or tiles. Only the surface's own shading, and which lights an interval
sees, are asked of the renderer.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.render.camera import pixel_grid, rays
from mesoshell.render.effects import Effects
from mesoshell.render.quality import Quality
from mesoshell.render.sequence import draws_at
from mesoshell.render.tiles import RenderReport
from mesoshell.shell.geometry.sampling import Chart, Frame, Piece, frame, place, place_exact, spread
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.field import Point, inputs
from mesoshell.shell.render.lighting import Shaded, Tile
from mesoshell.shell.render.renderer import _Renderer
from mesoshell.shell.render.scene import Scene

#: Samples a call.
_CHUNK = 16384


def picture(scene: Scene, quality: Quality, effects: Effects) -> Float[np.ndarray, "H W 4"]:
    """Linear RGBA, one ray a pixel, `quality.samples` samples a ray, distant lights and no background."""
    renderer = _Renderer(scene, quality, effects, RenderReport())
    camera = scene.camera
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    d = d.astype(np.float32).astype(np.float64)
    traced = renderer.boundary.trace(o, d, exact=True)
    i = traced.intervals
    beams = renderer.lighting.beams(draws_at(np.zeros((len(o), 2)), 0.0))
    with jax.enable_x64(True):
        chart, material = jax.tree.map(_wide, (renderer.media.chart, renderer.media.each[0].table.material))
        along = (i.t0, i.t1 - i.t0), (i.bary0, i.bary1), (i.h0, i.h1)
        ends = (np.stack(x, axis=1).astype(np.float64) for x in along)
        start = o[i.ray] + i.t0[:, None] * d[i.ray] - renderer.third[i.prism]
        pieces = Piece(i.prism, *ends, start, d[i.ray])
        at = jax.tree.map(np.asarray, jax.jit(jax.vmap(partial(frame, chart)))(pieces))
        plan = spread(i, at.length, quality.samples, "length")
        row = np.repeat(np.arange(len(i.ray)), plan.count)
        within = np.arange(len(row)) - np.repeat(np.cumsum(plan.count) - plan.count, plan.count)
        length = np.maximum(at.length, 1e-300)
        f = np.clip(((within + plan.first[row] + 0.5) * plan.step[row] - plan.begin[row]) / length[row], 0, 1)
        share = np.minimum(plan.step / length, 1.0)[row]
        toward = np.stack([beam.toward[0] for beam in beams])

        @jax.jit
        def some(piece: Piece, at: Frame, f: jax.Array, share: jax.Array) -> tuple[jax.Array, jax.Array]:
            one = partial(_sample, renderer, material, chart, jnp.asarray(toward))
            return jax.vmap(one)(piece, at, f, share)

        sigma, rho = np.zeros(len(row)), np.zeros((len(row), len(beams), 3), np.float32)
        for begin in range(0, len(row), _CHUNK):
            part = np.minimum(np.arange(begin, begin + _CHUNK), len(row) - 1)
            piece, frames = jax.tree.map(lambda x, part=part: x[row[part]], (pieces, at))
            end = min(begin + _CHUNK, len(row))
            found = some(piece, frames, f[part], share[part])
            sigma[begin:end], rho[begin:end] = (np.asarray(x)[: end - begin] for x in found)
    tau = sigma * plan.step[row]
    through = np.cumsum(tau)
    ray = i.ray[row]
    first = np.searchsorted(ray, ray)
    before = (through - tau) - (through - tau)[first]
    weight = np.exp(-before) * -np.expm1(-tau)
    depth = np.bincount(ray, tau, len(o))
    tile = Tile(o, d, beams)
    shaded = Shaded(row.astype(np.int32), f, ray, weight, rho)
    rgb = renderer.lighting.shell(tile, i, shaded, Frame(*at))
    rgb += np.exp(-depth)[:, None] * renderer.lighting.surfaces(tile, traced, np.exp(-depth))
    alpha = np.where(np.isfinite(traced.end), 1.0, -np.expm1(-depth))
    return np.concatenate([rgb, alpha[:, None]], axis=1).reshape(camera.height, camera.width, 4)


def _wide(x: jax.Array) -> jax.Array:
    return jnp.asarray(x, jnp.float64)


def _sample(renderer, material, chart: Chart, lights, piece: Piece, at: Frame, f, share) -> tuple:
    """σ, and ρ toward each light, of the sample at position f."""
    placed = place(piece, at, f, share, jnp.asarray(renderer.media.each[0].table.cone, jnp.float64))
    xi = place_exact(chart, piece, f)
    alpha = jnp.asarray(renderer.media.each[0].table.alpha, jnp.float64)
    height = jnp.asarray(renderer.media.each[0].table.height_filter, jnp.float64) * placed.footprint.height
    x = inputs(material, renderer.media.each[0].program.layout, Point(xi, placed.footprint.minor, height, alpha))
    sigma, found = net.trunk(material.decoder, x)
    shared = net.toward_viewer(material.decoder, found, net.direction(at.inverse, -piece.direction))
    return sigma, jax.vmap(lambda w: net.head(material.decoder, shared, net.direction(at.inverse, w)))(lights)
