"""What a generator is before it has learned: neither layers nor columns, and nothing for noise to be made of."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.start import begun
from mesoshell.nets.mlp import Dense
from mesoshell.render.camera import look_at
from mesoshell.shell.generator.generator import init_averages
from mesoshell.train.gan.generate import ImageBatch, generate
from mesoshell.train.gan.presets import TINY
from mesoshell.train.gan.state import Learner, sized_for, start
from mesoshell.train.update import HERE

CONFIG = sized_for(TINY, 1, 0)
BATCH = 4


def test_plane_and_height_are_both_heard_in_density() -> None:
    """The plane had 1 of 100 once, and a run learned to stack layers."""
    run = jax.jit(lambda seed: begun(CONFIG, seed))
    found = np.mean([run(seed) for seed in range(6)], axis=0)
    assert found.min() > 0.1, found


@pytest.mark.slow
def test_thin_layers_do_not_turn_into_noise() -> None:
    """A material that varies with height alone, from above: a picture's pixels agree better than pictures with other samples.

    With places of samples drawn for each ray, layers become noise, and a generator learns to make do with that for blades.
    """
    config = replace(CONFIG, picture=replace(CONFIG.picture, samples=64))
    learner = jax.jit(lambda key: start(config, key).learner)(jax.random.key(0))
    flat = learner.generator.layers[-1]
    layers = [*learner.generator.layers[:-1], flat._replace(weight=jnp.zeros_like(flat.weight))]
    sharp = [Dense(30 * layer.kernel, layer.bias) for layer in learner.decoder.trunk]
    learner = Learner(learner.generator._replace(layers=layers), learner.decoder._replace(trunk=sharp))
    above = jnp.asarray(look_at((0.5, 0.5, 8.0), (0.5, 0.5, 0.5), (0.0, 1.0, 0.0)), jnp.float32)
    batch = ImageBatch(
        jnp.zeros((BATCH, 16, 16, 4)),
        jnp.full((BATCH, 1), 0.5),
        jnp.zeros((BATCH, 0)),
        jnp.tile(above[None], (BATCH, 1, 1)),
        jnp.tile(jnp.array([[0.0, 0.0, 1.0]]), (BATCH, 1)),
        jnp.ones((BATCH, 3)),
        jax.random.key_data(jax.random.split(jax.random.key(1), BATCH)),
    )
    averages = init_averages(config.generator)
    made, _ = jax.jit(lambda learner, batch: generate(config, learner, averages, batch, HERE.each))(learner, batch)
    inner = np.asarray(made)[:, 7:9, 7:9]
    between, within = np.ptp(inner.mean(axis=(1, 2)), axis=0).max(), np.ptp(inner, axis=(1, 2)).max()
    assert between > 1e-2
    assert within < between / 4
