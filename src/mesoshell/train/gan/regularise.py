"""Two optional regularisers: blur of early pictures, and a penalty on density that changes over small steps.

Notation
s            standard deviation of the blur, pixels: `blur` at first, falling linearly to 0 at `blur_kimg`
δ            standard deviation of the step between two points, canonical lengths
σ            extinction in units of the decoder's scale

Both come from public 3D-aware GANs (Chan et al. 2022: s = 10 at 512², δ = 0.004, weight 0.25). Both are off by
default; what is off is not computed.
"""

import math

import jax
import jax.numpy as jnp

from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.field import Material, Point, inputs
from mesoshell.train.patch_renderer import PictureConfig
from mesoshell.typing import Array, Float, Key, Scalar

STEP, POINTS = 0.004, 256


def blur(y: Float[Array, "B S S I"], s: Scalar, most: float) -> Float[Array, "B S S I"]:
    """Gaussian of deviation s ≤ most; beyond the edges y repeats its last pixels. s = 0 is the identity."""
    reach = math.ceil(3 * most)
    at = jnp.arange(-reach, reach + 1, dtype=y.dtype)
    weight = jnp.exp(-0.5 * (at / jnp.maximum(s, 1e-3)) ** 2)
    weight = weight / jnp.sum(weight)
    for axis in (1, 2):
        size = y.shape[axis]
        where = jnp.clip(jnp.arange(size)[:, None] + jnp.arange(-reach, reach + 1)[None], 0, size - 1)
        matrix = jnp.zeros((size, size), y.dtype).at[jnp.arange(size)[:, None], where].add(weight[None])
        y = jnp.moveaxis(jnp.tensordot(matrix, y, ((1,), (axis,)), precision="highest"), 0, axis)
    return y


def roughness(config: PictureConfig, material: Material, alpha: Float[Array, "A"], key: Key[Array, ""]) -> Scalar:
    """Mean |σ(ξ) − σ(ξ + step)| over random points of the box."""
    k = jax.random.split(key)
    dtype = alpha.dtype
    xi = jax.random.uniform(k[0], (POINTS, 3), jnp.float32).astype(dtype)
    near = jnp.clip(xi + STEP * jax.random.normal(k[1], xi.shape, jnp.float32).astype(dtype), 0, 1)

    def density(xi: Array) -> Array:
        zero = jnp.zeros((), dtype)
        return net.trunk(material.decoder, inputs(material, config.layout, Point(xi, zero, zero, alpha)))[0]

    return jnp.mean(jnp.abs(jax.vmap(density)(xi) - jax.vmap(density)(near)) / material.decoder.scale)
