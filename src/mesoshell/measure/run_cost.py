"""What a training run will cost, before it begins."""

import json
import time
from dataclasses import asdict
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.measure.flops import count_operations
from mesoshell.train.method import Data, method_of
from mesoshell.train.run_config import RunConfig


def run_cost(config: RunConfig, dataset: Data) -> str:
    """A few lines: parameters, memory, and the least time, operations over this machine's matrix rate. Compiles a step."""
    method = method_of(config)
    config, dataset = method.adapt(config, dataset)
    state = jax.eval_shape(lambda: method.start(config, dataset, jax.random.key(0)))
    batch = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), method.feed(config, dataset, 0, 1)(0))
    memory = jax.jit(lambda s, b: method.step(config, s, b)).lower(state, batch).compile().memory_analysis()
    about = {k: v for k, v in asdict(config).items() if k in ("batch", "kimg", "precision")}
    lines = [json.dumps(about)]
    lines += [
        f"{name}: {_numbers(tree):,} parameters, {_bytes(tree) / 2**20:.1f} MiB"
        for name, tree in method.parts(state).items()
    ]
    lines.append(f"state (with what optimisers and averages hold): {_bytes(state) / 2**20:.1f} MiB")
    if memory is not None:
        lines.append(f"a step's activations: {memory.temp_size_in_bytes / 2**20:.0f} MiB")
    work, rate = count_operations(lambda s, b: method.step(config, s, b), state, batch), _matrix_rate()
    steps = config.kimg * 1000 / config.batch
    lines.append(
        f"the dearest step is {work / 1e9:.3g} GFLOP; at this machine's matrix rate, {rate / 1e9:.0f} GFLOP/s, at least "
        f"{work / rate:.2g} s: {rate / work:.3g} steps a second at most, {steps * work / rate / 3600:.2g} hours in all"
    )
    return "\n".join(lines)


def _numbers(tree: object) -> int:
    return sum(int(np.prod(x.shape)) for x in jax.tree.leaves(tree))


def _bytes(tree: object) -> int:
    return sum(int(np.prod(x.shape)) * x.dtype.itemsize for x in jax.tree.leaves(tree))


def _matrix_rate() -> float:
    """Operations a second of a float32 product of 2048² matrices: the best of three."""
    a = jnp.ones((2048, 2048), jnp.float32)
    product = jax.jit(partial(jnp.matmul, precision="highest"))
    product(a, a).block_until_ready()
    best = 1e9
    for _ in range(3):
        begin = time.perf_counter()
        product(a, a).block_until_ready()
        best = min(best, time.perf_counter() - begin)
    return 2 * 2048**3 / best
