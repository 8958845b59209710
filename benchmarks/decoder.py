"""Decoder evaluation against the machine's matrix rate: python -m benchmarks.decoder

A loop over tiles runs on one core, so a render works on as many image tiles at once as there are cores: so does this.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp

from benchmarks.rates import best, matrix_rate
from mesoshell.nets.mlp import TILE, in_tiles
from mesoshell.shell.material import decoder as net

ROWS = 64 * TILE
INPUTS, TRUNK, HEAD = 42, (64, 64, 64), (64, 64)


def main() -> None:
    key = jax.random.key(0)
    decoder = net.init_decoder(key, INPUTS, TRUNK, HEAD)
    x = jax.random.normal(key, (ROWS, INPUTS))
    found = jax.random.normal(key, (ROWS, TRUNK[-1]))
    w = net.normalise(jax.random.normal(key, (ROWS, 3)))
    count = jnp.int32(ROWS)
    like = ((0, jnp.float32), (TRUNK[-1], jnp.float32))
    trunk = jax.jit(lambda d, x, n: in_tiles(lambda r: net.trunk(d, r), n, (x,), like))
    one = lambda d, f, w: (net.head(d, net.toward_viewer(d, f, w), w),)  # noqa: E731
    head = jax.jit(lambda d, f, w, n: in_tiles(lambda a, b: one(d, a, b), n, (f, w), ((3, jnp.float32),)))
    plain = jax.jit(lambda d, x: net.trunk(d, x))
    trunk_work = 2 * (INPUTS * 64 + 2 * 64 * 64 + 64)
    head_work = 2 * (70 * 64 + 64 * 64 + 64 * 3)
    rate, cores = matrix_rate(), os.cpu_count() or 1
    pool = ThreadPoolExecutor(cores)

    def on_all(call: Callable) -> Callable:
        return lambda: list(pool.map(lambda _: jax.block_until_ready(call()), range(cores)))

    print(f"matrix product: {rate / 1e9:.0f} GFLOP/s\n")
    print("| part | rows a second | GFLOP/s | share of the matrix rate |\n|---|---|---|---|")
    for name, work, seconds in (
        ("trunk, tiled", trunk_work, best(on_all(lambda: trunk(decoder, x, count))) / cores),
        ("head, tiled", head_work, best(on_all(lambda: head(decoder, found, w, count))) / cores),
        ("trunk, one call", trunk_work, best(lambda: plain(decoder, x))),
    ):
        done = ROWS * work / seconds
        print(f"| {name} | {ROWS / seconds / 1e6:.1f} M | {done / 1e9:.0f} | {done / rate:.2f} |")


if __name__ == "__main__":
    main()
