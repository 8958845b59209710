"""Trees that are compared leaf for leaf."""

from typing import Any

import jax
import numpy as np

from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.field import FieldConfig

FIELD = FieldConfig((8,), (8,), (8,), (8,), 8, "hash", hash=HashConfig(2, 2, 6, 4, 8), octaves=(2, 2, 1))


def same(a: Any, b: Any) -> None:
    """One structure, the same bits."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(np.asarray(x), np.asarray(y))
        assert x.dtype == y.dtype


def apart(a: Any, b: Any) -> float:
    """Largest difference of two trees' leaves, over each leaf's largest value in the first."""
    pairs = [(np.asarray(x), np.asarray(y)) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)]
    return max(float(np.abs(x - y).max() / max(float(np.abs(x).max()), 1e-12)) for x, y in pairs)
