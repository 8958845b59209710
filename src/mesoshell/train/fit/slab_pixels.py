"""A pixel of a patch as the renderer computes it, and its residual against a render.

Notation
R, N        rays of a row, and candidate samples a ray
occupancy   largest recent σ in each cell of (h, v, u): candidates in empty cells are not decoded        (D, V, U)
x, y        radiance; x/(1+x) of it, and alpha

Samples are spread over the ray's part in the box, filtered, decoded; optical depth is summed and composited.
"""

from functools import partial

import jax
import jax.numpy as jnp

from mesoshell.numerics import optical_depth
from mesoshell.render.composite import tonemap, weights
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material, Point, inputs
from mesoshell.train.fit.patch_rays import Rays
from mesoshell.train.patch_renderer import PictureConfig, along
from mesoshell.typing import Array, Bool, Float, Scalar

#: Samples a tile of the network on a CPU: forward and backward pass of one tile stay in a core's cache.
_TILE = 1024
#: Least 1 − y of a target and of a prediction: it limits fireflies to radiance 99 (renders of the recipe stay below 14), and
#: keeps predictions finite.
_FIREFLY, _DARKEST = 1e-2, 1e-6


def predict(
    layout: Layout, decoded: float, material: Material, row: Rays, occupancy: Array, jitter: Float[Array, "R N"]
) -> tuple[Float[Array, "R 4"], Bool[Array, "R"], Scalar]:
    """y of every ray; which rays had all their occupied candidates decoded; occupied candidates over the budget. decoded: the
    budget, as a share of all candidates."""
    r, n = jitter.shape
    spread = partial(along, PictureConfig(samples=n))
    points, length = jax.vmap(spread)(row.origin, row.direction, row.radius, jitter)
    flat = jax.tree.map(lambda x: x.reshape(r * n, *x.shape[2:]), points)
    flat = flat._replace(xi=_on_torus(layout.period, row.patch, flat.xi))
    lengths = jnp.repeat(length, n)
    wide = flat.radius > layout.period / occupancy.shape[1]  # a filter wider than a cell covers its neighbours
    depth = occupancy.reshape(-1)[cell_of(flat.xi, occupancy.shape, layout.period)] * lengths
    occupied = wide | (depth > 5e-3) | (decoded >= 1)
    budget = max(_TILE, int(decoded * r * n) // _TILE * _TILE)
    (chosen,) = jnp.nonzero(occupied, size=budget, fill_value=r * n - 1)
    wanted = jnp.sum(occupied)
    valid = jnp.arange(budget) < wanted
    ray = chosen // n
    complete = (wanted <= budget) | (jnp.arange(r) < ray[-1])
    some = Point(flat.xi[chosen], flat.radius[chosen], flat.height_deviation[chosen], row.alpha[ray])
    x = jax.vmap(inputs, in_axes=(None, None, 0))(material, layout, some)
    sigma, rho = decode(material.decoder, x, -row.direction[ray], row.light[ray])
    tau = jnp.where(valid, optical_depth(sigma, lengths[chosen]), 0.0)
    taus = jnp.zeros(r * n, tau.dtype).at[chosen].add(tau).reshape(r, n)
    share, through = jax.vmap(weights)(taus)
    radiance = jnp.where(valid, share.reshape(-1)[chosen], 0.0)[:, None] * rho * row.irradiance[ray]
    colour = jnp.zeros((r, 3), radiance.dtype).at[ray].add(radiance)
    y = jnp.concatenate([tonemap(colour), 1 - through[:, None]], axis=1)
    return y, complete, wanted.astype(y.dtype) / budget


def _on_torus(period: int, patch: Array, xi: Float[Array, "S 3"]) -> Float[Array, "S 3"]:
    """Points of a patch's unit box, moved to its place in a texture of period × period patches, row by row."""
    if period == 1:
        return xi
    return xi.at[:, :2].add(jnp.stack([patch % period, patch // period]).astype(xi.dtype))


def cell_of(xi: Float[Array, "*batch 3"], shape: tuple[int, ...], period: int = 1) -> Array:
    """Flat index of the occupancy cell of a point; u and v wrap, after `period` patches."""
    depth, rows, columns = shape
    uv = xi[..., :2] / period
    uv = uv - jnp.floor(uv)
    u = jnp.clip((uv[..., 0] * columns).astype(jnp.int32), 0, columns - 1)
    v = jnp.clip((uv[..., 1] * rows).astype(jnp.int32), 0, rows - 1)
    h = jnp.clip((xi[..., 2] * depth).astype(jnp.int32), 0, depth - 1)
    return (h * rows + v) * columns + u


def decode(decoder: Decoder, x: Array, w: Array, light: Array) -> tuple[Array, Array]:
    """σ and ρ of many samples, recomputed in the backward pass: on a CPU in tiles whose activations stay in the cache."""

    def tile(rows: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        sigma, features = net.trunk(decoder, rows[0])
        return sigma, net.head(decoder, net.toward_viewer(decoder, features, rows[1]), rows[2])

    side = _TILE if jax.default_backend() == "cpu" else x.shape[0]
    split = jax.tree.map(lambda a: a.reshape(-1, side, a.shape[-1]), (x, w, light))
    sigma, rho = jax.lax.map(jax.checkpoint(tile), split)
    return sigma.reshape(-1), rho.reshape(-1, 3)


def residual(y: Float[Array, "*batch 4"], target: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The residual that the loss squares: (x − x̂) / (1 + x)², with no gradient through the denominator; and the error of alpha.

    To first order this is the difference of y. But where the material cannot tell pixels apart, the best x is their mean
    (Lehtinen et al. 2018, section 3.4); the mean of y is darker, the more the pixels differ: 7% for grass over 4 × 4 of them.
    """
    dark, true = jnp.maximum(1 - y[..., :3], _DARKEST), jnp.maximum(1 - target[..., :3], _FIREFLY)
    colour = jnp.square(jax.lax.stop_gradient(dark)) * (1 / dark - 1 / true)
    return jnp.concatenate([colour, y[..., 3:] - target[..., 3:]], axis=-1)
