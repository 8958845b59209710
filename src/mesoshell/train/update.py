"""What an update of any method shares: collectives over devices, a step of its optimiser, and which gradients are unusable."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from mesoshell.typing import Array, Bool

#: A gradient whose square float32 cannot hold.
MOST = 1e19


class Across(NamedTuple):
    """What devices share when each holds rows of its own, and whether a device sees its pictures at once or in turn.

    mean: over devices; everyone: all rows (B, …) and which of them are this device's (b,), None where arrays are global.
    """

    mean: Callable[[Any], Any] = lambda tree: tree
    everyone: Callable[[Array], tuple[Array, Array]] | None = None
    each: Callable[[Callable], Callable] = jax.vmap

    def rows(self, x: Any) -> int:
        """Rows of a step on all devices, of which x (b, …) are this one's."""
        return x.shape[0] if self.everyone is None else self.everyone(x)[0].shape[0]


#: Arrays are global: one device, or several that the compiler spreads them over.
HERE = Across()


def descent(adam: optax.GradientTransformation, tree: Any, memory: Any, gradient: Any) -> tuple[Any, Any]:
    """What to add to `tree`, and the optimiser's memory after the step."""
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        return adam.update(gradient, memory, tree)


def updated(adam: optax.GradientTransformation, tree: Any, memory: Any, gradient: Any) -> tuple[Any, Any]:
    """`tree` after a step of its optimiser, and the memory."""
    updates, memory = descent(adam, tree, memory, gradient)
    return optax.apply_updates(tree, updates), memory


def not_finite(tree: Any) -> Bool[Array, "_leaves"]:
    """Which leaves hold NaN, infinity, or what Adam's squares turn into it: such a weight would never move again."""
    return jnp.stack([~(jnp.abs(leaf) < MOST).all() for leaf in jax.tree.leaves(tree)])
