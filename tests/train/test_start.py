"""What a generator is before it has learned: neither layers nor columns, and nothing for noise to be made of."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.mlp import Dense
from mesoshell.render.camera import look_at
from mesoshell.shell import decoder as net
from mesoshell.shell.field import Point, inputs
from mesoshell.shell.generator import draw_phases, init_averages, map_latent, synthesise, synthesise_height
from mesoshell.train.generate import Shown, generate
from mesoshell.train.picture import material_of
from mesoshell.train.presets import TINY
from mesoshell.train.state import Learner, TrainConfig, sized, start
from mesoshell.train.step import HERE

CONFIG = sized(TINY, 1, 0)
BATCH = 8


def log_sigma(config: TrainConfig, seed: jax.Array) -> jax.Array:
    """log σ on a grid (h, v, u) over one patch, of a generator that begins with this seed."""
    key = jax.random.key(seed)
    learner = start(config, key).learner
    made, averages = learner.generator, init_averages(config.generator)
    w = map_latent(made, jax.random.normal(key, (1, config.generator.z)), jnp.zeros((1, 0)))
    phases, side = draw_phases(config.generator, key, 1), config.generator.texels
    feature = synthesise(config.generator, made, averages, w, phases, jnp.zeros(2, jnp.int32), (side, side)).feature
    height = synthesise_height(config.generator, made, w)
    material = material_of(config.picture, feature[0], height[0], learner.decoder)
    at = jnp.asarray((np.indices((16, 16, 16)).reshape(3, -1).T + 0.5) / 16, jnp.float32)

    def sigma(hvu: jax.Array) -> jax.Array:
        point = Point(hvu[::-1], jnp.float32(0), jnp.float32(0), jnp.full(1, 0.5))
        return jnp.log(net.trunk(learner.decoder, inputs(material, config.picture.layout, point))[0])

    return jax.vmap(sigma)(at).reshape(16, 16, 16)


def test_plane_and_height_are_both_heard_in_density() -> None:
    """Analysis of variance: what the means along the other axes carry. The plane had 1 of 100 once: it learned layers."""
    plane, height = [], []
    run = jax.jit(lambda seed: log_sigma(CONFIG, seed))
    for seed in range(6):
        x = np.asarray(run(seed))
        plane.append(x.mean(axis=0).var() / x.var())
        height.append(x.mean(axis=(1, 2)).var() / x.var())
    assert np.mean(plane) > 0.1 and np.mean(height) > 0.1, (plane, height)


def test_thin_layers_do_not_turn_into_noise() -> None:
    """A material that varies with height alone, from above: a picture's pixels agree better than pictures with other samples.

    With places of samples drawn for each ray, layers become noise, and a generator learns to make do with that for blades.
    """
    config = replace(CONFIG, picture=replace(CONFIG.picture, samples=64))
    learner = start(config, jax.random.key(0)).learner
    flat = learner.generator.layers[-1]
    layers = [*learner.generator.layers[:-1], flat._replace(weight=jnp.zeros_like(flat.weight))]
    sharp = [Dense(30 * layer.kernel, layer.bias) for layer in learner.decoder.trunk]
    learner = Learner(learner.generator._replace(layers=layers), learner.decoder._replace(trunk=sharp))
    above = jnp.asarray(look_at((0.5, 0.5, 8.0), (0.5, 0.5, 0.5), (0.0, 1.0, 0.0)), jnp.float32)
    batch = Shown(
        jnp.zeros((BATCH, 16, 16, 4)),
        jnp.full((BATCH, 1), 0.5),
        jnp.zeros((BATCH, 0)),
        jnp.tile(above[None], (BATCH, 1, 1)),
        jnp.tile(jnp.array([[0.0, 0.0, 1.0]]), (BATCH, 1)),
        jnp.ones((BATCH, 3)),
        jax.random.key_data(jax.random.split(jax.random.key(1), BATCH)),
    )
    made, _ = generate(config, learner, init_averages(config.generator), batch, HERE.each)
    inner = np.asarray(made)[:, 7:9, 7:9]
    between, within = np.ptp(inner.mean(axis=(1, 2)), axis=0).max(), np.ptp(inner, axis=(1, 2)).max()
    assert between > 1e-2
    assert within < between / 4
