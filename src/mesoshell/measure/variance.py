"""Whether a material's density varies over the plane or over height: an analysis of variance.

Notation
x           log σ at the middles of n³ equal cells of a patch, (h, v, u)
plane       variance over (v, u) of x's mean over h, over the variance of x: 1 if every height is the same
height      variance over h of x's mean over (v, u), over the variance of x: 1 if it consists of uniform layers

The rest is interaction of both: blades that lean, tips that end.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.shell.material.field import Layout, Material, Point, neural_field
from mesoshell.typing import Array, Float, Scalar


class Shares(NamedTuple):
    """Shares of the variance; 0 if there is none."""

    plane: Scalar
    height: Scalar


def shares(layout: Layout, material: Material, alpha: Float[Array, "A"], n: int = 16) -> Shares:
    """Shares of one patch, unfiltered. alpha: appearance, normalised."""
    at = jnp.asarray((np.indices((n, n, n)).reshape(3, -1).T[:, ::-1] + 0.5) / n, jnp.float32)
    zero, field = jnp.zeros((), jnp.float32), neural_field(material, layout)
    x = jax.vmap(lambda xi: jnp.log(field.density(Point(xi, zero, zero, alpha))[0]))(at).reshape(n, n, n)
    whole = jnp.maximum(x.var(), jnp.finfo(x.dtype).tiny)
    return Shares(x.mean(axis=0).var() / whole, x.mean(axis=(1, 2)).var() / whole)
