"""Run in a process of its own: one step in float64 on one device and on eight, by the way that is given: jit, sharded, or pmap.

Prints one JSON object: the largest relative difference of losses, and of gradients by leaf (Adam's first
moment with β₁ = 0 is the gradient).
"""

import json
import os
import sys
from dataclasses import replace
from functools import partial

os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.train.gan.state import start
from mesoshell.train.gan.step import step
from mesoshell.train.parallel import spread_step
from tests.helpers.small_step import CONFIG as PLAIN
from tests.helpers.small_step import batch

CONFIG = replace(PLAIN, mismatch=0.5)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    begin = jax.jit(partial(start, CONFIG))(jax.random.key(0))  # in one program: step by step it is hundreds
    exact = jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, begin)
    one, how = jax.jit(lambda s, b: step(CONFIG, s, b))(exact, batch()), sys.argv[1]
    spread = spread_step(lambda s, b, across: step(CONFIG, s, b, across), CONFIG.batch, how)
    state, report, _ = spread.step(spread.place(jax.tree.map(jnp.copy, exact)), spread.share(batch()))
    several = spread.whole(state), report
    said = {}
    for name, pick in {
        "losses": lambda r: r[1][:5],
        "learner": lambda r: r[0].learner_adam[0].mu,
        "discriminator": lambda r: r[0].discriminator_adam[0].mu,
        "averages": lambda r: r[0].averages,
    }.items():
        pairs = zip(jax.tree.leaves(pick(one)), jax.tree.leaves(pick(several)), strict=True)
        said[name] = max(
            float(np.abs(np.asarray(a) - np.asarray(b)).max() / max(float(np.abs(a).max()), 1e-12)) for a, b in pairs
        )
    said["images"] = int(several[0].images)
    alone = spread_step(lambda s, b, across: (s, b), CONFIG.batch, "pmap").share(
        batch()._replace(beta=np.zeros((8, 0)))
    )
    said["a device's share of no parameters"] = float(alone.beta.shape != (8, 1, 0))
    print(json.dumps(said))


if __name__ == "__main__":
    main()
