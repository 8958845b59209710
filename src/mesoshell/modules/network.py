"""The base of all modules: a tree of parameters, drawn by a pure function and declared to Flax field by field.

Notation
tree        parameters as the pure functions take them, and as checkpoints and bundles keep them: a NamedTuple of pytrees
variables   Flax's: collections by name; each is {field: that part of a tree}, and may be given as the tree itself
"""

from collections.abc import Callable, Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from mesoshell.typing import Array, Key


class Network(nn.Module):
    """A module that declares what `draw` gives, and whose `__call__` hands it to the pure functions. With the same key, `init`
    gives the same bits as `draw`."""

    def draw(self, key: Key[Array, ""]) -> Any:
        """The tree of parameters at the start."""
        raise NotImplementedError

    @nn.compact
    def tree(self) -> Any:
        """The tree of parameters: `module.bind(variables).tree()`; or their declaration: `module.init(key, method="tree")`."""
        return self.declared("params", self.draw)

    def declared(self, collection: str, draw: Callable[[Key[Array, ""]], Any]) -> Any:
        """A tree whose fields are the variables of a collection."""
        like = jax.eval_shape(draw, jax.random.key(0))
        if self.is_initializing() and self.scope is not None:
            own: Any = self.scope.rngs["params"]
            drawn = draw(own.as_jax_rng())
        else:  # Flax only checks the given variables against shapes
            drawn = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), like)

        def declare(name: str, part: Any) -> Any:
            if collection == "params":
                return self.param(name, lambda key: part)
            return self.variable(collection, name, lambda: part).value

        return type(like)(*(declare(*part) for part in drawn._asdict().items()))

    @nn.nowrap
    def apply(self, variables: Mapping[str, Any], *args: Any, **keywords: Any) -> Any:
        """Flax's, but a collection may be a tree."""
        return super().apply(by_field(variables), *args, **keywords)

    @nn.nowrap
    def bind(self, variables: Mapping[str, Any], *args: Any, **keywords: Any) -> Any:
        """Flax's, but a collection may be a tree."""
        return super().bind(by_field(variables), *args, **keywords)


def by_field(variables: Mapping[str, Any]) -> dict[str, Any]:
    """Variables with every collection in Flax's form."""
    return {name: tree._asdict() if hasattr(tree, "_asdict") else tree for name, tree in variables.items()}
