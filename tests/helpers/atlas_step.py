"""An object that a test can compile, and random rays for it. Run in a process of its own: one step in float64 on one device,
sharded over eight, and under pmap on eight.

Prints one JSON object: for each pair the largest relative difference of losses, and of gradients (Adam's first moment after one
step is a tenth of the gradient).
"""

import json
import os
from typing import Any

if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.encoding import HashConfig
from mesoshell.neutex.field import FieldConfig
from mesoshell.train.neutex.ray_batches import Rays
from mesoshell.train.neutex.step import NeuTexTrainConfig, start, step
from mesoshell.train.parallel import spread_step
from tests.helpers.same_trees import apart

FIELD = FieldConfig((8, 8), (8,), (8, 8), (8, 8), 8, "hash", octaves=(2, 2, 1), hash=HashConfig(3, 2, 8, 4, 12))
CONFIG = NeuTexTrainConfig(
    FIELD, side=16, samples=8, batch=16, kimg=0.16, cloud=True, chamfer=0.5, finish=0.2, snapshot_kimg=0.08
)


def rays(seed: int = 0) -> Rays:
    """From outside toward the middle."""
    random = np.random.default_rng(seed)

    def unit(x: np.ndarray) -> np.ndarray:
        return x / np.linalg.norm(x, axis=1, keepdims=True)

    o = 2.5 * unit(random.normal(size=(16, 3)))
    d = unit(random.uniform(-0.5, 0.5, (16, 3)) - o)
    rows = o, d, random.random((16, 3)), random.integers(2, size=16)
    rest = 0.6 * unit(random.normal(size=(16, 3))), unit(random.normal(size=(16, 3)))
    columns: list[Any] = [x.astype(np.float32) for x in (*rows, *rest)]
    columns.insert(4, np.arange(16, dtype=np.int32))
    return Rays(*columns)


def main() -> None:
    jax.config.update("jax_enable_x64", True)

    def exact(tree):
        def wide(x):
            return jnp.asarray(x, jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else jnp.asarray(x)

        return jax.tree.map(wide, tree)

    begin, batch = exact(start(CONFIG, jax.random.key(0))), exact(rays())
    said = {}
    alone = jax.jit(lambda s, b: step(CONFIG, s, b))
    spreads = {
        how: spread_step(lambda s, b, across: step(CONFIG, s, b, across), CONFIG.batch, how) for how in ("jit", "pmap")
    }
    # in the first half of the run with the cloud, in the second without
    for phase, images in (("early", 0), ("late", 100)):
        state = begin._replace(images=jnp.asarray(images, jnp.int32))
        one = alone(state, batch)
        for how, spread in spreads.items():
            after, report, _ = spread.step(spread.place(jax.tree.map(jnp.copy, state)), spread.share(batch))
            after = spread.whole(after)
            pairs = {
                "losses": (one[1][:-1], report[:-1]),
                "state": (one[0].adam, after.adam),
                "grid": (one[0].grid, after.grid),
            }
            for name, (a, b) in pairs.items():
                said[f"{phase} {how} {name}"] = apart(a, b)
            said[f"{phase} {how} images"] = int(after.images) - images
    print(json.dumps(said))


if __name__ == "__main__":
    main()
