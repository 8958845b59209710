"""The projected discriminator sees what the network sees of the picture as it is shown; heads judge rows apart."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.image import linear_to_srgb
from mesoshell.io.weights import read_lite0
from mesoshell.nets import efficientnet
from mesoshell.shell.generator.discriminator import DiscriminatorConfig
from mesoshell.shell.generator.projected import ENDS, LOUDER, SPREAD, WITH_OPACITY, init_projected, judge, project
from mesoshell.train.losses import r1

CONFIG = DiscriminatorConfig(16, channel_base=64, channel_max=8, labels=3, embedding=8, opacity=True, kind="projected")
HEADS = init_projected(CONFIG, jax.random.key(0))
Y = jax.random.uniform(jax.random.key(1), (4, 16, 16, 4), minval=-1.0)
C = jax.random.normal(jax.random.key(2), (4, 3))
SEEN = jax.jit(project)
LOGITS = jax.jit(partial(judge, HEADS))


def test_maps_are_the_networks_of_the_picture_on_a_screen() -> None:
    """Encoded as sRGB, at twice the size, in units of their spread; opacity's means are a channel of one map."""
    shown = linear_to_srgb((np.asarray(Y[..., :3]) + 1) / 2)
    net = efficientnet.efficientnet(read_lite0())
    maps = jax.jit(lambda x: efficientnet.activations(net, x, ENDS, 32))(jnp.asarray(shown))
    found = SEEN(Y)
    assert [x.shape[1:] for x in found] == [(16, 16, 16), (8, 8, 24), (4, 4, 41), (2, 2, 112)]
    for f, x, spread in zip(found, maps, SPREAD, strict=True):
        np.testing.assert_allclose(f[..., : x.shape[-1]], x / spread, atol=1e-3)
    covered = np.asarray(Y[..., 3]).reshape(4, 4, 4, 4, 4).mean(axis=(2, 4))
    np.testing.assert_allclose(found[WITH_OPACITY][..., 40], LOUDER * covered, rtol=0, atol=1e-5)
    assert [x.shape[-1] for x in jax.eval_shape(project, Y[..., :3])] == [16, 24, 40, 112]


def test_it_depends_on_picture_opacity_and_label_and_on_no_other_row() -> None:
    d = LOGITS(SEEN(Y), C)
    assert d.shape == (4, 4)
    assert (jnp.abs(LOGITS(SEEN(-Y), C) - d).max(axis=0) > 1e-3).all()
    assert (jnp.abs(LOGITS(SEEN(Y), C[::-1]) - d).max(axis=0) > 1e-3).all()
    clear = jnp.abs(LOGITS(SEEN(Y.at[..., 3].set(-1.0)), C) - d).max(axis=0)
    assert clear[WITH_OPACITY] > 1e-3 and clear.at[WITH_OPACITY].set(0.0).max() == 0
    other = LOGITS(SEEN(Y.at[1:].set(0.5)), C)
    np.testing.assert_allclose(other[0], d[0], rtol=0, atol=1e-4)


def test_gradients_are_finite_where_pictures_are_black_or_as_bright_as_can_be() -> None:
    """sRGB is steepest at black."""
    slope = jax.jit(jax.grad(lambda y: jnp.sum(judge(HEADS, project(y), C))))
    for y in (jnp.full_like(Y, -1.0), jnp.full_like(Y, 1.0), jnp.round(Y)):
        gradient = slope(y)
        assert jnp.isfinite(gradient).all() and jnp.abs(gradient).max() > 0


def test_r1_at_the_maps_against_finite_differences() -> None:
    with jax.enable_x64(True):
        heads, f, c = jax.tree.map(lambda x: x.astype(jnp.float64), (HEADS, SEEN(Y), C))

        def with_weight(weight):
            head = heads.heads[1]._replace(first=heads.heads[1].first._replace(weight=weight))
            return heads._replace(heads=[heads.heads[0], head, *heads.heads[2:]])

        penalty = jax.jit(
            lambda weight: r1(lambda f: judge(with_weight(weight), f, c, dtype=jnp.float64), f, (1.0,) * 4)
        )
        weight = heads.heads[1].first.weight
        way = np.random.default_rng(0).normal(size=weight.shape)
        slope = (penalty(weight + 1e-6 * way) - penalty(weight - 1e-6 * way)) / 2e-6
        np.testing.assert_allclose((jax.grad(penalty)(weight) * way).sum(), slope, rtol=1e-6)
        assert abs(slope) > 1e-6


@pytest.mark.parametrize("size", [0, 4, 12, 100])
def test_sizes_that_cannot_be_halved_are_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"not {size}"):
        init_projected(replace(CONFIG, size=size), jax.random.key(0))
