"""March a ray through the box: its samples, and their composite.

Notation
o, d        in the box's units; t in [t0, t1]: inside [−1, 1]³, all of it, in front of the camera
occupied    cells of the box where σ can be too large to skip, with their neighbours
ℓ           length of [t0, t1] in occupied cells; the N samples share it evenly: one in each N-th of it, at ξ of that part
w, T        weights of the samples and transmittance of the ray (render/composite); I = Σ w c
away        Σ w max(n·d, 0)²: how much of the reflecting surface is seen from behind (Verbin et al. 2022, Ref-NeRF, equation 11)
flash       of reflectance: light comes from the camera; all that the camera sees is fully lit, as on a surface (inside a fog,
            light would be attenuated once more)

Samples lie at ℓ/N from each other on occupied stretches: a ray without occupied cells has none, and none lies in an empty
cell. Occupancy is tested at PROBES points along a ray, less than a cell apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.neutex.brdf import Lobes, shade
from mesoshell.neutex.field import Field, FieldConfig, density, lobes, normal, radiance, to_texture
from mesoshell.numerics import optical_depth
from mesoshell.render.composite import weights
from mesoshell.typing import Array, Bool, Float, Scalar, Vec3

#: Cells along a side of the grid, and probes along a ray: √3 · CELLS would lie a cell apart on the longest ray.
CELLS, PROBES = 32, 64


class Marched(NamedTuple):
    """colour: I; passed: T; w and y: of the samples; away: 0 but of reflectance."""

    colour: Vec3
    passed: Scalar
    w: Float[Array, "N"]
    y: Float[Array, "N 3"]
    away: Scalar


def span(o: Vec3, d: Vec3) -> tuple[Scalar, Scalar]:
    """t0 and t1; t1 = t0 where the ray misses the box. A direction may have zeros, or be zero."""
    tiny = jnp.asarray(1e-20, d.dtype)
    slow = jnp.where(jnp.abs(d) < tiny, jnp.where(d < 0, -tiny, tiny), d)
    a, b = (-1 - o) / slow, (1 - o) / slow
    t0 = jnp.maximum(jnp.max(jnp.minimum(a, b)), 0)
    t1 = jnp.min(jnp.maximum(a, b))
    return t0, jnp.maximum(t1, t0)


def places(o: Vec3, d: Vec3, occupied: Bool[Array, "n n n"], xi: Float[Array, "N"]) -> tuple[Float[Array, "N"], Scalar]:
    """t of the samples, and ℓ/N. xi: each sample's position in its part, 0 to 1."""
    t0, t1 = span(o, d)
    edges = t0 + (t1 - t0) * jnp.linspace(0, 1, PROBES + 1, dtype=o.dtype)
    middle = (edges[1:] + edges[:-1]) / 2
    held = at(occupied, o[None] + jnp.outer(middle, d))
    through = jnp.concatenate([jnp.zeros(1, o.dtype), jnp.cumsum(jnp.where(held, (t1 - t0) / PROBES, 0))])
    n = xi.shape[0]
    wanted = (jnp.arange(n, dtype=o.dtype) + xi) * (through[-1] / n)
    return jnp.interp(wanted, through, edges), through[-1] / n


def at(occupied: Bool[Array, "n n n"], y: Float[Array, "*k 3"]) -> Bool[Array, "*k"]:
    """Whether the cells that points of the box lie in, y in [−1, 1]³, are occupied."""
    n = occupied.shape[0]
    cell = jnp.clip(jnp.floor((y + 1) * (n / 2)).astype(jnp.int32), 0, n - 1)
    return occupied[cell[..., 0], cell[..., 1], cell[..., 2]]


def dilate(held: Bool[Array, "n n n"]) -> Bool[Array, "n n n"]:
    """Cells and all their neighbours."""
    return jax.lax.reduce_window(held, False, jax.lax.bitwise_or, (3, 3, 3), (1, 1, 1), "SAME")


def march(
    config: FieldConfig, field: Field, o: Vec3, d: Vec3, occupied: Bool[Array, "n n n"], xi: Float[Array, "N"]
) -> Marched:
    """March one ray."""
    t, step = places(o, d, occupied, xi)
    y = o[None] + jnp.outer(t, d)
    sigma, features = jax.vmap(lambda y: density(config, field, y))(y)
    w, passed = weights(optical_depth(sigma, jnp.broadcast_to(step, sigma.shape)))
    away = jnp.zeros((), y.dtype)
    if config.colour == "reflectance":
        made = jax.vmap(lambda y: lobes(config, field, to_texture(field, y)))(y)
        n = jax.vmap(lambda y, f: normal(field, y, f))(y, features)
        away = jnp.sum(w * jnp.maximum(jnp.sum(n * d[None], axis=1), 0) ** 2)
        c = jax.vmap(lambda made, n, t: flash_radiance(config, made, n, d, t))(made, n, t)
    else:
        c = jax.vmap(lambda y, f: radiance(config, field, y, d, f))(y, features)
    return Marched(jnp.matmul(w, c, precision="highest"), passed, w, y, away)


def flash_radiance(config: FieldConfig, made: Lobes, n: Vec3, d: Vec3, t: Scalar) -> Vec3:
    """c of a point at distance t from a camera that lights it, without attenuation on the way."""
    return shade(made, n, -d, -d) * (config.flash / jnp.maximum(t, 1e-3) ** 2)
