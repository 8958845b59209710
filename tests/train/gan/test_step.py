"""A training step: the same on any number of devices however it is spread, and R1 in float32 always."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.numerics import softplus
from mesoshell.shell.generator.discriminator import discriminate
from mesoshell.train.gan.generate import label
from mesoshell.train.gan.state import Learner, TrainState, optimisers, start
from mesoshell.train.gan.step import seen, step
from mesoshell.train.patch_renderer import discriminator_range
from tests.helpers import small_step

ROOT = Path(__file__).parents[3]

#: One process compiles what its tests share.
pytestmark = pytest.mark.xdist_group("train_step")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["jit", "pmap"])
def test_one_device_and_eight_agree(how: str) -> None:
    """Losses, gradients of both players and averages to 1e-6, eight devices with one row each: groups and means are global."""
    command = [sys.executable, "-m", "tests.helpers.three_ways", how]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert len(said) == 6
    for name, value in said.items():
        assert value == 8 if name.endswith("images") else value < 1e-6, name


@cache
def begun() -> TrainState:
    """In one program: step by step it is hundreds."""
    return jax.jit(partial(start, small_step.CONFIG))(jax.random.key(0))


@cache
def stepped(**changes: float) -> tuple:
    """The state after one step of a configuration that is changed so, and what it reports."""
    config = replace(small_step.CONFIG, **changes)
    batch = jax.tree.map(
        lambda x: jnp.asarray(x) if x.dtype == np.uint32 else jnp.asarray(x, jnp.float32), small_step.batch()
    )
    return jax.jit(lambda s, b: step(config, s, b))(begun(), batch)


@pytest.mark.slow  # test_run sees that every weight has a gradient
def test_everything_moves_and_nothing_is_bad() -> None:
    state, report = stepped()
    before = begun()
    assert not report.bad.any() and int(state.step) == 1 and int(state.images) == 8
    still = [
        jax.tree_util.keystr(path)
        for (path, a), b in zip(
            jax.tree_util.tree_leaves_with_path((before.learner.generator, before.discriminator)),
            jax.tree.leaves((state.learner.generator, state.discriminator)),
            strict=True,
        )
        if jnp.array_equal(a, b)
    ]
    assert still == []


@pytest.mark.slow
def test_helps_change_what_they_are_asked_to_change() -> None:
    """First moments are gradients. A blur reaches both players; both report nothing bad."""
    (plain, _), (helped, report) = stepped(), stepped(blur=2.0, density=0.25)
    assert not report.bad.any()
    for pick in (lambda s: s.learner_adam[0].mu.decoder, lambda s: s.discriminator_adam[0].mu):
        pairs = zip(jax.tree.leaves(pick(plain)), jax.tree.leaves(pick(helped)), strict=True)
        assert any(np.abs(x - y).max() > 1e-2 * np.abs(x).max() for x, y in pairs)


@pytest.mark.slow
def test_renders_beside_the_next_ones_parameters_count_as_made() -> None:
    """For the discriminator alone, by the weight that was asked for."""
    (plain, before), (told, after) = stepped(), stepped(mismatch=0.5)
    for a, b in zip(jax.tree.leaves(plain.learner), jax.tree.leaves(told.learner), strict=True):
        np.testing.assert_array_equal(a, b)
    batch = small_step.batch()
    wrong = batch._replace(alpha=np.roll(batch.alpha, -1, axis=0), beta=np.roll(batch.beta, -1, axis=0))
    wrong = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), wrong)
    y, c = discriminator_range(wrong.image[..., :3]), label(wrong)
    logits = jax.jit(discriminate)(begun().discriminator, y, c)
    more = 0.5 * np.mean(np.log1p(np.exp(logits)))
    assert more > 0.1
    np.testing.assert_allclose(after.discriminator - before.discriminator, more, rtol=1e-4)


def test_a_discriminator_that_sees_opacity_tells_a_gap_from_a_dark_blade() -> None:
    config = small_step.CONFIG
    told = replace(config, discriminator=replace(config.discriminator, opacity=True))
    picture = jnp.zeros((2, 8, 8, 4)).at[1, ..., 3].set(1.0).at[1, 0, 4, 3].set(0.0)
    blind, seeing = seen(config, picture), seen(told, picture)
    assert blind.shape[-1] == 3 and bool((blind[0] == blind[1]).all())
    wanted = jnp.stack([-jnp.ones((8, 8)), jnp.ones((8, 8)).at[:4, 4:].set(2 * 15 / 16 - 1)])
    assert seeing.shape[-1] == 4 and bool((seeing[..., 3] == wanted).all())
    state = jax.eval_shape(lambda: start(told, jax.random.key(0)))
    assert state.discriminator.colour.weight.shape[2] == 4
    floats = jax.tree.map(lambda x: x if x.dtype == np.uint32 else x.astype(np.float32), small_step.batch())
    after, _ = jax.eval_shape(lambda s, b: step(told, s, b), state, floats)
    assert jax.tree.map(jnp.shape, after) == jax.tree.map(jnp.shape, state)


@pytest.mark.parametrize(
    "kind", ["residual", *(pytest.param(x, marks=pytest.mark.slow) for x in ("projected", "vision-aided"))]
)
def test_r1_is_float32_where_convolutions_are_not(kind: str) -> None:
    """In the traced step, the update that is there every 16th step has no half-precision value; the rest has."""
    config = replace(small_step.CONFIG, precision="bfloat16")
    config = replace(config, discriminator=replace(config.discriminator, kind=kind))
    state = jax.eval_shape(lambda: start(config, jax.random.key(0)))
    floats = jax.tree.map(lambda x: x if x.dtype == np.uint32 else x.astype(np.float32), small_step.batch())
    traced = jax.make_jaxpr(lambda s, b: step(config, s, b))(state, floats).jaxpr
    lazy = max((e for e in traced.eqns if e.primitive.name == "cond"), key=lambda e: len(e.outvars))
    assert len(lazy.outvars) > len(jax.tree.leaves(state.discriminator))
    assert "bf16" in str(traced) and "bf16" not in str(lazy.params["branches"])


def test_a_decoder_begins_dark_and_learns_at_the_generators_pace() -> None:
    state = begun()
    adam, _ = optimisers(small_step.CONFIG)
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        ones = jax.tree.map(np.ones_like, state.learner)
        updates, _ = jax.jit(adam.update)(ones, state.learner_adam, state.learner)
    generator, decoder = cast(Learner, updates)
    rate = small_step.CONFIG.generator_rate
    np.testing.assert_allclose(generator.layers[0].weight, -rate, rtol=1e-5)
    for layer in (*decoder.trunk, decoder.sigma, *decoder.head, decoder.rho):
        np.testing.assert_allclose(layer.kernel, -rate / len(layer.kernel) ** 0.5, rtol=1e-5)
        np.testing.assert_allclose(layer.bias, -rate, rtol=1e-5)
    assert decoder.scale == 0
    rho = softplus(state.learner.decoder.rho.bias - 2)
    assert 0.1 < 40 * float(rho[0]) < 0.25  # the median of a render's covered pixels is 0.165


def test_where_pictures_teach_the_plane_nothing_else_moves() -> None:
    state = begun()
    adam, _ = optimisers(replace(small_step.CONFIG, taught="plane"))
    with jax.numpy_dtype_promotion("standard"):
        ones = jax.tree.map(np.ones_like, state.learner)
        updates, _ = jax.jit(adam.update)(ones, state.learner_adam, state.learner)
    generator, decoder = cast(Learner, updates)
    still = jax.tree.leaves((generator.mapping, generator.height, decoder))
    moved = jax.tree.leaves((generator.mix, generator.strength, generator.layers))
    assert still and not any(np.any(x) for x in still)
    for x in moved:
        np.testing.assert_allclose(x, -small_step.CONFIG.generator_rate, rtol=1e-5)


def test_labels_say_where_the_camera_and_the_light_are() -> None:
    batch = small_step.batch()
    c = label(jax.tree.map(jnp.asarray, batch))
    eye = batch.camera_to_world[:, :3, 3] - 0.5
    parameters = np.concatenate([batch.alpha, batch.beta], axis=1)
    turns = [f(2 * np.pi * parameters) for f in (np.sin, np.cos)]
    np.testing.assert_allclose(c[:, :6], np.concatenate([2 * parameters - 1, *turns], axis=1), rtol=0, atol=1e-5)
    np.testing.assert_allclose(c[:, 6:9], eye / np.linalg.norm(eye, axis=1, keepdims=True), rtol=1e-5)
    np.testing.assert_allclose(c[:, 9], np.log(np.linalg.norm(eye, axis=1)), rtol=1e-5)
    np.testing.assert_allclose(c[:, 10:], batch.light, rtol=1e-6)
