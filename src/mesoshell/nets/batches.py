"""Any number of rows through a program compiled for a fixed number.

A kernel takes arrays of CAPACITY rows and a count, and does work for the first `count` rows only.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

CAPACITY = 65536


def capacity(rows: int) -> int:
    """Rows to pad arrays to that kernels index, so that there are few shapes, each of which is compiled."""
    most = CAPACITY
    while most < rows:
        most *= 4
    return most


def pad(x: np.ndarray, rows: int) -> np.ndarray:
    """x with rows of zeros appended, up to `rows`."""
    out = np.zeros((rows, *x.shape[1:]), x.dtype)
    out[: len(x)] = x
    return out


def batches(kernel: Callable, *rows: Any) -> list:
    """kernel(*rows, count) on any number of rows, CAPACITY at a time, padded; its results as they come."""
    count = len(rows[0])
    results = []
    for begin in range(0, max(count, 1), CAPACITY):
        n = min(CAPACITY, count - begin)
        results.append(kernel(*(pad(x[begin : begin + n], CAPACITY) for x in rows), np.int32(n)))
    return results


def run(kernel: Callable, *rows: Any) -> Any:
    """Results of `batches` as NumPy arrays, concatenated and cut to the number of rows."""
    parts = [jax.tree.map(np.asarray, result) for result in batches(kernel, *rows)]
    return jax.tree.map(lambda *x: np.concatenate(x)[: len(rows[0])], *parts)
