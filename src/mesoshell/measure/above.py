"""A flat field of patches from straight above, without a mesh: its opacities by layer, and a picture.

Notation
P            patches along a side of the field; n pixels a patch
K            layers of equal height; layer 0 lies on the base
opacity      1 − e^{−σ/K} of a layer                                                      (K, P n, P n)
picture      x/(1 + x) of the radiance toward a viewer far above, over black              (P n, P n, 3)

Every pixel is filtered by its own width. Row 0 is v = 0.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.numerics import opacity, optical_depth
from mesoshell.render.composite import tonemap, weights
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.field import Layout, Material, Point, inputs
from mesoshell.shell.material.loader import DeviceMaterial

#: E⊥ of a picture's light, the same as the recipes'.
_IRRADIANCE = 40.0


def opacities(
    loaded: DeviceMaterial, alpha: Float[np.ndarray, "A"], field: tuple[int, int], layers: int
) -> Float[np.ndarray, "K V U"]:
    """Opacities of the field. field: P and n."""
    return np.asarray(_opacities(loaded.layout, (field, layers), loaded.material, jnp.asarray(alpha)))


@partial(jax.jit, static_argnums=(0, 1))
def _opacities(layout: Layout, how: tuple, material: Material, alpha: jax.Array) -> jax.Array:
    field, layers = how
    sigma = jax.lax.map(lambda v: _row(layout, material, alpha, how, v)[0], _rows(field))
    return jnp.moveaxis(opacity(sigma / layers), -1, 0)


def picture(
    loaded: DeviceMaterial,
    alpha: Float[np.ndarray, "A"],
    field: tuple[int, int],
    light: tuple[float, float, float],
    layers: int,
) -> Float[np.ndarray, "V U 3"]:
    """The picture. field: P and n; light: a unit vector toward it."""
    return np.asarray(_picture(loaded.layout, (field, layers, light), loaded.material, jnp.asarray(alpha)))


@partial(jax.jit, static_argnums=(0, 1))
def _picture(layout: Layout, how: tuple, material: Material, alpha: jax.Array) -> jax.Array:
    field, layers, light = how

    def row(v: jax.Array) -> jax.Array:
        sigma, hidden = _row(layout, material, alpha, (field, layers), v)
        up = jnp.broadcast_to(jnp.array([[0.0, 0.0, 1.0]]), (sigma.size, 3))
        toward = jnp.broadcast_to(jnp.array([light], jnp.float32), (sigma.size, 3))
        rho = net.head(material.decoder, net.toward_viewer(material.decoder, hidden, up), toward)
        tau = optical_depth(sigma[:, ::-1], jnp.full(sigma.shape, 1 / layers))
        share = jax.vmap(weights)(tau)[0]
        rho = rho.reshape(*sigma.shape, 3)[:, ::-1]
        return tonemap(_IRRADIANCE * jnp.einsum("uk,ukc->uc", share, rho, precision="highest"))

    return jax.lax.map(row, _rows(field))


def _row(layout: Layout, material: Material, alpha: jax.Array, how: tuple, v: jax.Array) -> tuple:
    """σ (U, K) of a row of pixels, and the trunk's features for the head, (U K, W)."""
    (patches, pixels), layers = how
    u, h = jnp.meshgrid(_centres(patches * pixels) * patches, _centres(layers), indexing="ij")
    xi = jnp.stack([u, jnp.broadcast_to(v, u.shape), h], axis=-1).reshape(-1, 3)
    radius, deviation = (jnp.full(len(xi), 1 / (12**0.5 * n)) for n in (pixels, layers))
    points = Point(xi, radius, deviation, jnp.broadcast_to(alpha, (len(xi), len(alpha))))
    x = jax.vmap(partial(inputs, material, layout))(points)
    sigma, hidden = net.trunk(material.decoder, x)
    return sigma.reshape(u.shape), hidden


def _rows(field: tuple[int, int]) -> jax.Array:
    return _centres(field[0] * field[1]) * field[0]


def _centres(n: int) -> jax.Array:
    return (jnp.arange(n, dtype=jnp.float32) + 0.5) / n
