"""The code under test on many sides at once, from NumPy and back."""

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.geometry.patch import Crossing, leave_side, post_function


@jax.jit
def _leave(d: jax.Array, p: jax.Array, n: jax.Array) -> Crossing:
    f = jax.vmap(jax.vmap(post_function, in_axes=(None, 0, 0)))(d, p, n)
    return jax.vmap(leave_side)(d, p, n, f)


def leave_sides(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> Crossing:
    """`leave_side` on rows of rays from 0 and sides, with F at the posts as the prism walk gives it."""
    return jax.tree.map(np.asarray, _leave(jnp.asarray(d), jnp.asarray(p), jnp.asarray(n)))
