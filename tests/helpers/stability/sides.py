"""The code under test on many sides at once, from NumPy and back, and as an accelerator would compute it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.products import BITS, rounded
from mesoshell.geometry.patch import Crossing, leave_side, post_function

#: How many bits operands of matrix products keep: all on a CPU.
OPERANDS = {"float32": 23, **BITS}


def leave(d: jax.Array, p: jax.Array, n: jax.Array) -> Crossing:
    """`leave_side` on rows of rays from 0 and sides, with F at the posts as the prism walk gives it."""
    f = jax.vmap(jax.vmap(post_function, in_axes=(None, 0, 0)))(d, p, n)
    return jax.vmap(leave_side)(d, p, n, f)


def leave_sides(d: np.ndarray, p: np.ndarray, n: np.ndarray, operands: str = "float32") -> Crossing:
    return on(operands, leave)(d, p, n)


def on(operands: str, function: Callable) -> Callable:
    """A function of arrays, compiled, whose matrix products have such operands; from NumPy and back."""
    compiled = jax.jit(rounded(function, OPERANDS[operands]))
    return lambda *x: jax.tree.map(np.asarray, compiled(*(jnp.asarray(a) for a in x)))
