"""Three steps of a fit of corner tiles on one device, sharded over two, and under pmap on two; in a process of its own.

Prints one JSON object: for each way the largest relative difference of textures, decoder and occupancy to one device's.
"""

import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.train.fit.feed import adapt, feed
from mesoshell.train.fit.patch_rays import gather_fit_data
from mesoshell.train.fit.state import FitConfig
from mesoshell.train.fit.step import start, step
from mesoshell.train.parallel import spread_step
from tests.helpers.patch_images import of_tiles
from tests.helpers.same_trees import apart

SMALL = FitConfig(texels=4, channels=4, height_rows=4, octaves=1, trunk=(8,), head=(8,), batch=8, rays=32, candidates=8)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as folder:
        data = gather_fit_data([of_tiles(Path(folder) / "set", [*range(16)])])
    config, data = adapt(replace(SMALL, decoded=1.0, rate=1e-3, texture_rate=1e-3), data)
    begin = start(config, data, jax.random.key(0))
    exact = jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, begin)
    at = feed(config, data)
    one, alone = exact, jax.jit(lambda s, b: step(config, s, b)[0])
    for i in range(3):
        one = alone(one, at(i))
    said = {}
    for how in ("jit", "pmap"):
        spread = spread_step(lambda s, b, across: step(config, s, b, across), config.batch, how, config.together)
        state = spread.place(jax.tree.map(jnp.copy, exact))
        for i in range(3):
            state, _, _ = spread.step(state, spread.share(at(i)))
        held = [np.asarray(x.data) for x in state.own.occupancy.addressable_shards]
        said[f"{how} devices"] = max(float(np.abs(x.ravel() - held[0].ravel()).max()) for x in held)
        state = spread.whole(state)
        for name, (a, b) in {"own": (one.own, state.own), "common": (one.common, state.common)}.items():
            said[f"{how} {name}"] = apart(a, b)
        said[f"{how} images"] = int(state.images)
    print(json.dumps(said))


if __name__ == "__main__":
    main()
