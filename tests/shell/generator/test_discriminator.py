"""The discriminator sees pictures, labels and the variety of a batch; its derivatives hold up."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.shell.generator.discriminator import (
    GROUP,
    Conv,
    DiscriminatorConfig,
    _deviation,
    discriminate,
    init_discriminator,
)
from mesoshell.train.losses import discriminator_loss, generator_loss, r1

CONFIG = DiscriminatorConfig(size=16, channel_base=64, channel_max=8, labels=3, embedding=8)
JUDGE = init_discriminator(CONFIG, jax.random.key(0))
Y = jax.random.uniform(jax.random.key(1), (8, 16, 16, 3), minval=-1.0)
C = jax.random.normal(jax.random.key(2), (8, 3))
LOGITS = jax.jit(lambda y, c: discriminate(JUDGE, y, c))


def test_it_depends_on_picture_label_and_batch() -> None:
    d = LOGITS(Y, C)
    assert d.shape == (8,)
    assert jnp.abs(LOGITS(-Y, C) - d).max() > 1e-3
    assert jnp.abs(LOGITS(Y, C[::-1]) - d).max() > 1e-3
    alike = LOGITS(jnp.broadcast_to(Y[:1], Y.shape), jnp.broadcast_to(C[:1], C.shape))
    np.testing.assert_allclose(alike, alike[0], rtol=1e-5)
    assert jnp.abs(alike[0] - d[0]) > 1e-4, "a batch of one picture repeated must be seen"


def test_deviation_is_that_of_samples_a_quarter_batch_apart() -> None:
    x = np.random.default_rng(0).normal(size=(8, 2, 3, 5)).astype(np.float32)
    found = _deviation(jnp.asarray(x), None)
    for i in range(8):
        expected = np.sqrt(x[i % 2 :: 2].var(axis=0) + 1e-8).mean()
        np.testing.assert_allclose(found[i], np.full((2, 3, 1), expected), rtol=1e-5)


@pytest.mark.parametrize("batch", [1, 2, 3, GROUP])
def test_deviation_of_small_batches_is_finite_with_finite_gradients(batch: int) -> None:
    x = jnp.ones((batch, 2, 2, 3))
    value, gradient = jax.value_and_grad(lambda x: jnp.sum(_deviation(x, None)))(x)
    assert jnp.isfinite(value) and jnp.isfinite(gradient).all()
    assert batch > 1 or value == 0


@pytest.mark.parametrize("size", [0, 4, 12, 100])
def test_sizes_that_cannot_be_halved_to_four_are_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"not {size}"):
        init_discriminator(replace(CONFIG, size=size), jax.random.key(0))


def test_first_and_second_derivatives_against_finite_differences() -> None:
    """R1 differentiates a gradient: resampling, deviation and all else must allow it."""
    with jax.enable_x64(True):
        judge = jax.tree.map(lambda x: x.astype(jnp.float64), JUDGE)
        y, c = Y[:4].astype(jnp.float64), C[:4].astype(jnp.float64)
        penalty = jax.jit(lambda weight: r1(
            lambda y: discriminate(judge._replace(colour=Conv(weight, judge.colour.bias)), y, c, None, jnp.float64), y, 1.0
        ))  # fmt: skip
        weight, way = judge.colour.weight, np.random.default_rng(0).normal(size=judge.colour.weight.shape)
        slope = (penalty(weight + 1e-6 * way) - penalty(weight - 1e-6 * way)) / 2e-6
        np.testing.assert_allclose((jax.grad(penalty)(weight) * way).sum(), slope, rtol=1e-6)
        assert abs(slope) > 1e-3


def test_bfloat16_convolutions_agree_with_float32() -> None:
    exact, short = LOGITS(Y, C), jax.jit(lambda y, c: discriminate(JUDGE, y, c, dtype=jnp.bfloat16))(Y, C)
    assert short.dtype == jnp.float32
    np.testing.assert_allclose(short, exact, atol=0.05 * float(jnp.std(exact)) + 0.02)


def test_losses_are_what_they_are_on_paper() -> None:
    real, fake = np.array([2.0, -1.0]), np.array([0.5, -3.0])
    log = lambda x: np.log1p(np.exp(x))  # noqa: E731
    np.testing.assert_allclose(generator_loss(jnp.asarray(fake, jnp.float32)), log(-fake).mean(), rtol=1e-6)
    expected = log(-real).mean() + log(fake).mean()
    found = discriminator_loss(jnp.asarray(real, jnp.float32), jnp.asarray(fake, jnp.float32))
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    slope = jnp.array([[[[1.0, 2.0, 2.0]]]])
    np.testing.assert_allclose(
        r1(lambda y: jnp.sum(y * slope, axis=(1, 2, 3)), jnp.zeros((1, 1, 1, 3)), 4.0), 4 / 2 * 9
    )
