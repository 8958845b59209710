"""The vision-aided discriminator is the residual one and the heads, half and half."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.shell.generator import projected
from mesoshell.shell.generator.discriminator import DiscriminatorConfig, discriminate
from mesoshell.shell.generator.vision_aided import init_vision_aided, judge, penalties, perceive
from mesoshell.train.losses import generator_loss, r1

CONFIG = DiscriminatorConfig(
    8, channel_base=32, channel_max=4, labels=3, embedding=4, opacity=True, kind="vision-aided"
)
BOTH = init_vision_aided(CONFIG, jax.random.key(0))
Y = jax.random.uniform(jax.random.key(1), (4, 8, 8, 4), minval=-1.0)
C = jax.random.normal(jax.random.key(2), (4, 3))


def test_each_weighs_a_half_in_losses_and_its_gamma_in_r1() -> None:
    f = jax.jit(perceive)(Y)
    heads = jax.jit(partial(projected.judge, BOTH.projected))(f[1], C)
    pixels = jax.jit(partial(discriminate, BOTH.residual))(Y, C)
    both = jax.jit(partial(judge, BOTH))(f, C)
    np.testing.assert_allclose(both, np.concatenate([np.repeat(pixels[:, None], 4, 1), heads], 1), atol=1e-5)
    half = (generator_loss(pixels) + generator_loss(heads)) / 2
    np.testing.assert_allclose(generator_loss(both), half, rtol=1e-6)
    found = jax.jit(lambda f: r1(lambda f: judge(BOTH, f, C), f, tuple(8 * k for k in penalties(0.03))))(f)
    one = jax.jit(lambda y: r1(lambda y: discriminate(BOTH.residual, y, C), y, 8 * 0.03))(Y)
    four = jax.jit(lambda f: r1(lambda f: projected.judge(BOTH.projected, f, C), f, (2.0,) * 4))(f[1])
    np.testing.assert_allclose(found, (one + four) / 2, rtol=1e-4)
    assert min(one / four, four / one) > 1e-3  # neither is within the tolerance


def test_rows_of_other_devices_are_known() -> None:
    f = jax.jit(perceive)(Y)

    def everyone(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.concatenate([x, 2 * x]), jnp.arange(len(x))

    known = jax.jit(lambda: judge(BOTH, f, C, everyone))()
    pixels = jax.jit(lambda: discriminate(BOTH.residual, Y, C, everyone))()
    np.testing.assert_allclose(known[:, :4], np.repeat(pixels[:, None], 4, 1), atol=1e-5)
    alone = jax.jit(partial(judge, BOTH))(f, C)
    assert np.abs(known - alone)[:, 0].max() > 1e-3
    np.testing.assert_allclose(known[:, 4:], alone[:, 4:], atol=1e-5)
