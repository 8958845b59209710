"""Shared by the updates of all methods: collectives over devices, a step of the optimiser, and a check of gradients."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mesoshell.typing import Array, Bool

#: Gradients from here on have squares that overflow float32.
MAX_GRADIENT = 1e19


class Across(NamedTuple):
    """Collectives for devices with rows of their own, and how a device computes its rows.

    mean: over devices; everyone: all rows (B, …) and which of them are this device's (b,), None where arrays are global;
    each: applies a function of one row to all, at once or in turn.
    """

    mean: Callable[[Any], Any] = lambda tree: tree
    everyone: Callable[[Array], tuple[Array, Array]] | None = None
    each: Callable[[Callable], Callable] = jax.vmap

    def rows(self, x: Any) -> int:
        """Rows of a step on all devices, of which x (b, …) are this one's."""
        return x.shape[0] if self.everyone is None else self.everyone(x)[0].shape[0]


#: For global arrays, on one device or spread over several by the compiler.
HERE = Across()


def descent(adam: optax.GradientTransformation, tree: Any, memory: Any, gradient: Any) -> tuple[Any, Any]:
    """What to add to `tree`, and the optimiser's memory after the step."""
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        return adam.update(gradient, memory, tree)


def apply_gradient(adam: optax.GradientTransformation, tree: Any, memory: Any, gradient: Any) -> tuple[Any, Any]:
    """`tree` after a step of its optimiser, and the memory."""
    updates, memory = descent(adam, tree, memory, gradient)
    return optax.apply_updates(tree, updates), memory


def not_finite(tree: Any) -> Bool[Array, "_leaves"]:
    """Which leaves hold NaN, infinity, or values whose squares in Adam overflow: their weights would never move again."""
    return jnp.stack([~(jnp.abs(leaf) < MAX_GRADIENT).all() for leaf in jax.tree.leaves(tree)])
