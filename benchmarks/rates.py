"""What this machine can do: the rates that floors are made of, probed in the run that uses them.

matrix      floating-point operations a second of a large float32 matrix product through JAX: as the backend does it for the
            layers of networks (a GPU in TF32), or with the precision that a program asks for
bandwidth   bytes a second of a copy that no cache holds
embree      rays a second that Embree traces against the given boundary, one thread, as the renderer calls it
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np


def best(function: Callable[[], object], repeats: int = 5) -> float:
    """Least seconds of several calls, after one that is not counted."""
    jax.block_until_ready(function())
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(function())
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def matrix_rate(n: int = 2048, precision: str | None = None) -> float:
    a = jax.random.normal(jax.random.key(0), (n, n), jnp.float32)
    product = jax.jit(lambda x: jnp.matmul(x, x, precision=precision))
    return 2 * n**3 / best(lambda: product(a))


def bandwidth(megabytes: int = 256) -> float:
    a = np.zeros(megabytes << 20, np.uint8)
    b = np.ones_like(a)
    return 2 * a.nbytes / best(lambda: np.copyto(b, a))


def embree_rate(boundary, o: np.ndarray, d: np.ndarray) -> float:
    o32, d32 = (o - boundary.centre).astype(np.float32), d.astype(np.float32)
    return len(o) / best(lambda: boundary.scene.run(o32, d32, output=True))
