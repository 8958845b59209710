"""How a generator begins, before it has learned: python -m benchmarks.start

Shares of log σ's variance that lie in the plane and in the height (mesoshell.measure.variance), means over seeds of the preset
`small`, by what F(u, v) and F(h) are multiplied with. What is loudest at the start is what the decoder learns to use.
"""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.measure.variance import Shares, shares
from mesoshell.shell.generator import generator
from mesoshell.shell.generator.generator import draw_phases, init_averages, map_latent, synthesise, synthesise_height
from mesoshell.train.gan.presets import SMALL
from mesoshell.train.gan.state import GanConfig, sized_for, start
from mesoshell.train.patch_renderer import material_of
from mesoshell.typing import Array

SEEDS = 6
SCALES = ((0.25, 0.25), (1.0, 0.25), (generator.PLANE_SCALE, generator.HEIGHT_SCALE))


def begun(config: GanConfig, seed: Array | int) -> Shares:
    """Shares of a texture of a generator that begins with this seed."""
    key = jax.random.key(seed)
    learner, texels = start(config, key).learner, config.generator.texels
    z = jax.random.normal(key, (1, config.generator.z), jnp.float32)
    w = map_latent(learner.generator, z, jnp.full((1, config.generator.betas), 0.5, jnp.float32))
    phases, averages = draw_phases(config.generator, key, 1), init_averages(config.generator)
    tile = jnp.zeros(2, jnp.int32)
    feature = synthesise(config.generator, learner.generator, averages, w, phases, tile, (texels, texels)).feature
    height = synthesise_height(config.generator, learner.generator, w)
    material = material_of(config.picture, feature[0], height[0], learner.decoder)
    return shares(config.picture.layout, material, jnp.full(config.appearance, 0.5, jnp.float32))


def main() -> None:
    config = sized_for(SMALL, 1, 0)
    print(f"{'F(u, v) times':>14} {'F(h) times':>11} {'plane':>7} {'height':>7}")
    for plane, height in SCALES:
        with mock.patch.multiple(generator, PLANE_SCALE=plane, HEIGHT_SCALE=height):
            run = jax.jit(lambda seed: begun(config, seed))
            found = np.mean([run(seed) for seed in range(SEEDS)], axis=0)
        print(f"{plane:14g} {height:11g} {found[0]:7.0%} {found[1]:7.0%}")


if __name__ == "__main__":
    main()
