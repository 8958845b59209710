"""A parametric network that a test can compile, and random renders for it. Run in a process of its own: one step in float64 on
one device, sharded over eight, and under pmap on eight.

Prints one JSON object: for each pair the largest relative difference of losses, and of gradients by leaf (Adam's first moment
after one step is a tenth of the gradient).
"""

import json
import os

if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"

import jax
import jax.numpy as jnp

from mesoshell.train.gan.generate import ImageBatch
from mesoshell.train.nerf_tex.network import NerfTexConfig, start, step
from mesoshell.train.parallel import spread_step
from tests.helpers import small_step
from tests.helpers.same_trees import apart

CONFIG = NerfTexConfig(small_step.CONFIG.picture, (16, 16), (8,), octaves=2, batch=8, parameters=2)


def batch() -> ImageBatch:
    return small_step.batch()


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    begin = start(CONFIG, jax.random.key(0))
    exact = jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, begin)
    one = jax.jit(lambda s, b: step(CONFIG, s, b))(exact, batch())
    said = {}
    for how in ("jit", "pmap"):
        spread = spread_step(lambda s, b, across: step(CONFIG, s, b, across), CONFIG.batch, how)
        state, report, _ = spread.step(spread.place(jax.tree.map(jnp.copy, exact)), spread.share(batch()))
        state = spread.whole(state)
        pairs = {"losses": (one[1][:2], report[:2]), "gradients": (one[0].adam[0].mu, state.adam[0].mu)}
        for name, (a, b) in pairs.items():
            said[f"{how} {name}"] = apart(a, b)
        said[f"{how} images"] = int(state.images)
    print(json.dumps(said))


if __name__ == "__main__":
    main()
