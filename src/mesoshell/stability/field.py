"""Checks of the material as the scene asks for it: its network, in single, double and half precision.

Notation
ξ           (u, v, h) of a point of the shell                                           (3,), canonical
a           opacity 1 − e^{−σℓ} of a step ℓ: what a picture shows of σ
ρ           transport
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.shell.material.field import Layout, Material, Point, inputs, neural_field
from mesoshell.shell.material.loader import Grid
from mesoshell.shell.material.precision import SHORT, STEP, decode
from mesoshell.shell.render.kernels import StaticConfig, bound
from mesoshell.shell.render.scene import Medium
from mesoshell.stability.checks import Check
from mesoshell.typing import Array

#: Points that are tried; the greatest error of a, and of aρ relative to its greatest value.
POINTS, ERROR = 20_000, 1e-4


def check_material_points(medium: Medium, uv: Float[np.ndarray, "P 3 2"], rng: np.random.Generator) -> list[Check]:
    """Random points of its prisms, whose corners have uv (patches), half of them with parameters at the ends of their ranges,
    unfiltered and widely filtered."""
    device_material = medium.device_material
    prism, share = rng.integers(0, len(uv), POINTS), rng.dirichlet((1, 1, 1), POINTS)
    h = np.clip(rng.uniform(-0.05, 1.05, POINTS), 0, 1)
    xi = np.concatenate([np.einsum("nk,nki->ni", share, uv[prism]), h[:, None]], axis=1).astype(np.float32)
    alpha = np.tile(medium.alpha, (POINTS, 1))
    alpha[::2] = rng.integers(0, 2, alpha[::2].shape)
    radius = np.where(np.arange(POINTS) % 4 < 2, 0, 10.0 ** rng.uniform(-3, 1, POINTS))
    toward = rng.normal(size=(2, POINTS, 3))
    toward[..., 2] = np.abs(toward[..., 2])
    w, w_light = (toward / np.linalg.norm(toward, axis=-1, keepdims=True)).astype(np.float32)
    point = Point(*(jnp.asarray(x, jnp.float32) for x in (xi, radius, radius / 10, alpha)))
    x, sigma, rho = (
        np.asarray(v) for v in _network_queries(device_material.layout, device_material.material, point, w, w_light)
    )
    checks = [_finite(sigma, rho)]
    exact_sigma, exact_rho = decode(device_material.material.decoder, x, w, w_light, np.dtype(np.float64))
    a, rest = _opacity(exact_sigma), (exact_sigma, exact_rho)
    error = np.max([np.abs(_opacity(sigma) - a).max(), _of_light(sigma, rho, *rest)])  # NaN stays
    line = f"float32 changes opacity and reflected light by at most {error:.1g}"
    checks.append(Check("network", line, float(error), ERROR))
    short = {k: decode(device_material.material.decoder, x, w, w_light, kind)[0] for k, kind in SHORT.items()}
    off = {k: float(np.sqrt(np.mean((_opacity(v) - a) ** 2) / max(np.mean(a**2), 1e-30))) for k, v in short.items()}
    line = "; ".join(
        f"{k} changes opacity by {v:.2%} (rms)" if np.isfinite(v) else f"{k} overflows" for k, v in off.items()
    )
    checks.append(Check("16 bits", line, 0.0, None))
    level = point.radius == 0
    limit = np.asarray(
        _bounds(
            StaticConfig(device_material.layout, device_material.grid_shapes, False, 1, False, ()),
            device_material.grid,
            point.xi,
        )
    )
    above = (sigma > limit)[np.asarray(level)]
    lost = (_opacity(sigma) - _opacity(limit))[np.asarray(level)][above]
    line = f"{above.mean():.2%} of points are denser than the bound by which empty space is skipped"
    line += f", by {lost.mean():.2f} in opacity" if above.any() else ""
    return [*checks, Check("skipping", line, 0.0, None)]


def _finite(sigma: np.ndarray, rho: np.ndarray) -> Check:
    wrong = ~(np.isfinite(sigma) & (sigma >= 0) & (np.isfinite(rho) & (rho >= 0)).all(axis=1))
    line = f"{wrong.sum()} of {len(wrong)} points have a density or reflectance that is negative or not finite"
    return Check("material", f"{line}; the greatest density is {sigma.max():.3g}", float(wrong.sum()), 0.0)


def _opacity(sigma: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    return -np.expm1(-STEP * sigma.astype(np.float64))


def _of_light(sigma: np.ndarray, rho: np.ndarray, exact_sigma: np.ndarray, exact_rho: np.ndarray) -> float:
    """The greatest error of aρ over its greatest value."""
    light, exact = _opacity(sigma)[:, None] * rho, _opacity(exact_sigma)[:, None] * exact_rho
    return float(np.abs(light - exact).max() / max(exact.max(), np.finfo(np.float64).tiny))


@partial(jax.jit, static_argnums=0)
def _network_queries(
    layout: Layout, material: Material, point: Point, w: Float[Array, "N 3"], w_light: Float[Array, "N 3"]
) -> tuple[Float[Array, "N I"], Float[Array, "N"], Float[Array, "N 3"]]:
    """Inputs of the network, σ and ρ of many points."""
    field = neural_field(material, layout)

    def one(p: Point, w: Array, w_light: Array) -> tuple[Array, Array, Array]:
        sigma, features = field.density(p)
        return inputs(material, layout, p), sigma, field.transport(features, w, w_light)

    return jax.vmap(one)(point, w, w_light)


@partial(jax.jit, static_argnums=0)
def _bounds(program: StaticConfig, grid: Grid, xi: Float[Array, "N 3"]) -> Float[Array, "N"]:
    """Bounds of σ at points that are not filtered."""
    return jax.vmap(lambda x: bound(program, grid, x, jnp.zeros(())))(xi)
