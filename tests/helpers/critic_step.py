"""A generator of textures and its critic that a test can compile. Run in a process of its own: one step in float64 on one
device, sharded over two, and under pmap on two.

Prints one JSON object: for each pair the largest relative difference of losses, and of gradients by leaf (Adam's first moment
after one step is the gradient).
"""

import json
import os

if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.io.exemplars import Exemplars
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.generator.texture_critic import CriticConfig
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.train.export import decoder_arrays
from mesoshell.train.parallel import spread_step
from mesoshell.train.textures import critic_view
from mesoshell.train.textures.exemplars import feed
from mesoshell.train.textures.state import TexturesConfig, adapt
from mesoshell.train.textures.step import start, step
from tests.helpers.same_trees import apart

GENERATOR = GeneratorConfig(texels=32, channel_base=128, channel_max=4, channels=4, layers=4, z=0, w=4, waves=2)
CONFIG = TexturesConfig(GENERATOR, CriticConfig(critic_view.CHANNELS, width=2), batch=2, adversarial=True, window=64)


def exemplars() -> Exemplars:
    """Two textures of noise, and a decoder that has learned nothing."""
    rng = np.random.default_rng(0)
    decoder = decoder_arrays(init_decoder(jax.random.key(0), 4 + 1 + 2, (4,), (4,)))
    features, height = (rng.normal(size=shape).astype(np.float32) for shape in ((2, 32, 32, 4), (8, 4)))
    return Exemplars(features, height, np.zeros((2, 0), np.float32), decoder, 1, (), {})


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    config, data = adapt(CONFIG, exemplars())
    begun, batch = start(config, data, jax.random.key(0)), feed(config, data)(0)
    exact = jax.tree.map(lambda x: x.astype(jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x, begun)
    batch = batch._replace(feature=batch.feature.astype(np.float64), beta=batch.beta.astype(np.float64))
    one = jax.jit(lambda s, b: step(config, s, b))(exact, batch)
    said = {}
    for how in ("jit", "pmap"):
        spread = spread_step(lambda s, b, across: step(config, s, b, across), config.batch, how)
        state, report, _ = spread.step(spread.place(jax.tree.map(jnp.copy, exact)), spread.share(batch))
        state = spread.whole(state)
        pairs = {
            "losses": (one[1][:-1], report[:-1]),
            "generator": (one[0].adam[0].mu, state.adam[0].mu),
            "critic": (one[0].versus.adam[0].mu, state.versus.adam[0].mu),
        }
        for name, (a, b) in pairs.items():
            said[f"{how} {name}"] = apart(a, b)
    print(json.dumps(said))


if __name__ == "__main__":
    main()
