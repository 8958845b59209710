"""Tiles of the generator are parts of one plane without an edge."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.shell.generator.generator import (
    Phases,
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, frequencies_of, rows_of, spans
from mesoshell.signal.fourier import shifted_phase
from mesoshell.typing import Array

#: Of as many layers as any.
DEEP = GeneratorConfig(
    texels=32, channel_base=256, channel_max=8, channels=4, waves=2, drift=1.5, z=8, w=8, height_rows=16
)
SMALL = replace(DEEP, layers=10)


@partial(jax.jit, static_argnums=(0, 1))
def _feature(config: GeneratorConfig, size: tuple[int, int], generator, averages, w, phases, tile) -> Array:
    return synthesise(config, generator, averages, w, phases, tile, size).feature


def made(config: GeneratorConfig, tile: tuple[int, int], size: tuple[int, int], phases: Phases | None = None) -> Array:
    generator, averages = init_generator(config, jax.random.key(0)), init_averages(config)
    w = map_latent(generator, jax.random.normal(jax.random.key(1), (1, config.z)), jnp.zeros((1, 0)))
    phases = draw_phases(config, jax.random.key(2), 1) if phases is None else phases
    at = jnp.array(tile, jnp.int32)
    with jax.numpy_dtype_promotion("strict"):
        return _feature(config, size, generator, averages, w, phases, at)


@pytest.mark.parametrize("config", ["T", pytest.param("R", marks=pytest.mark.slow)])
def test_a_tile_is_a_part_of_the_whole(config) -> None:
    config = replace(SMALL, config=config)
    whole = made(config, (-CELL, 0), (96, 64))
    np.testing.assert_allclose(made(config, (0, 0), (17, 40)), whole[:, 32:49, :40], rtol=0, atol=1e-5)
    np.testing.assert_allclose(made(config, (3, 5), (17, 40)), whole[:, 38:55, 10:50], rtol=0, atol=1e-5)


def test_textures_of_other_phases_differ_and_are_alike() -> None:
    a, b = (made(SMALL, (0, 0), (64, 64), draw_phases(SMALL, jax.random.key(k), 1)) for k in (5, 6))
    assert jnp.abs(a - b).max() > 0.5 * jnp.std(a)
    np.testing.assert_allclose(jnp.std(a), jnp.std(b), rtol=0.2)


def test_far_away_it_is_the_same_material() -> None:
    near, far = made(SMALL, (0, 0), (64, 64)), made(SMALL, (4096 * CELL, -4096 * CELL), (64, 64))
    np.testing.assert_allclose(jnp.std(near), jnp.std(far), rtol=0.2)
    assert jnp.abs(near - far).max() > 0.5 * jnp.std(near)


@pytest.mark.parametrize("fourier", ["frozen", pytest.param("off", marks=pytest.mark.slow)])
def test_variants_of_the_ablations(fourier) -> None:
    config = replace(SMALL, fourier=fourier)
    layers = frequencies_of(config).layers
    assert any(len(f) for f in layers) == (fourier == "frozen")
    a, b = (draw_phases(config, jax.random.key(k), 2) for k in (0, 1))
    assert (jnp.array_equal(a.input, b.input)) == (fourier == "frozen")
    assert made(config, (0, 0), (32, 32)).shape == (1, 32, 32, 4)


def test_maps_are_as_strong_as_they_learn_to_be() -> None:
    """A strength for each channel of each layer that has a map; without it, the layer's phases say nothing."""
    rows, layers = rows_of(SMALL), frequencies_of(SMALL).layers
    has = [i for i, f in enumerate(layers) if len(f)]
    generator, averages = init_generator(SMALL, jax.random.key(0)), init_averages(SMALL)
    for i, strength in zip(has, generator.strength, strict=True):
        np.testing.assert_allclose(strength, np.full(rows[i].in_channels, (2 / (i + 1)) ** 0.5), rtol=1e-6)
    w = map_latent(generator, jnp.ones((1, SMALL.z)), jnp.zeros((1, 0)))
    phases = draw_phases(SMALL, jax.random.key(2), 1)
    last = phases._replace(layers=[p + 0.3 * (i == has[-1]) for i, p in enumerate(phases.layers)])
    mute = generator._replace(strength=[*generator.strength[:-1], jnp.zeros_like(generator.strength[-1])])
    run = jax.jit(lambda g, p: synthesise(SMALL, g, averages, w, p, jnp.zeros(2, jnp.int32), (32, 32)).feature)
    assert jnp.abs(run(generator, phases) - run(generator, last)).max() > 1e-2
    np.testing.assert_array_equal(run(mute, phases), run(mute, last))


def test_maps_lie_between_the_cutoffs_and_the_last_layers_have_none() -> None:
    first, layers, slow = frequencies_of(DEEP)
    assert slow.shape == (8, 2)
    rows = rows_of(DEEP)
    assert np.hypot(*first.T).max() / 2**16 <= rows[0].in_cutoff
    for row, f in list(zip(rows, layers, strict=True))[1:13]:
        radius = np.hypot(*f.T) / 2**16
        assert (
            len(f) == DEEP.waves * row.in_channels
            and radius.min() >= row.in_cutoff - 1e-4
            and radius.max() <= row.out_cutoff + 1e-4
        )
    assert [len(f) for f in layers[13:]] == [0, 0]


def test_drifting_maps_stay_below_half_the_rate_and_cannot_be_turned() -> None:
    for row, m in zip(rows_of(DEEP), frequencies_of(DEEP).layers, strict=True):
        assert np.abs(m).max(initial=0) <= (row.in_sampling_rate / 2 - 2) * 2**16
    with pytest.raises(ValueError, match="turned"):
        frequencies_of(replace(DEEP, turn=90.0))


def test_spans_ask_for_what_the_filters_reach() -> None:
    """The halo is two to four patches, and padding is no more than the zeros between samples."""
    found = spans(rows_of(GeneratorConfig(texels=64)), 64)
    assert 2 < -found[0].first / CELL < 4
    assert all(0 <= span.pad[0] < row.up_factor for span, row in zip(found, rows_of(GeneratorConfig()), strict=True))
    assert found[-1].size == 64 and found[-1].pad == (0, 0)


def test_the_texture_moves_with_its_maps() -> None:
    """A translation by whole texels, which is a fraction of a sample in the inner layers."""
    phases = draw_phases(SMALL, jax.random.key(2), 1)
    first, layers, slow = frequencies_of(SMALL)
    shift = jnp.array([1 / 32, 3 / 32], jnp.float32)
    moved = Phases(
        shifted_phase(jnp.asarray(first), jnp.asarray(slow), phases.input, shift),
        [
            shifted_phase(jnp.asarray(f), jnp.asarray(slow), p, shift)
            for f, p in zip(layers, phases.layers, strict=True)
        ],
    )
    a, b = made(SMALL, (0, 0), (64, 64), phases)[:, :-1, :-3], made(SMALL, (0, 0), (64, 64), moved)[:, 1:, 3:]
    assert 10 * jnp.log10(4 * jnp.var(a) / jnp.mean((a - b) ** 2)) > 45


def test_beta_and_z_shape_w_and_the_height_feature() -> None:
    config = replace(SMALL, betas=2)
    generator = init_generator(config, jax.random.key(0))
    z, beta = jax.random.normal(jax.random.key(1), (1, 8)), jnp.array([[0.2, 0.9]])
    w = map_latent(generator, z, beta)
    assert jnp.abs(map_latent(generator, z, 1 - beta) - w).max() > 1e-2
    assert jnp.abs(map_latent(generator, 3 * z, beta) - w).max() < 1e-5, "z is brought to unit size"
    height = synthesise_height(config, generator, w)
    assert height.shape == (1, 16, 4)
    finer = synthesise_height(replace(config, height_rows=48), generator, w)
    np.testing.assert_allclose(finer[:, 1::3], height, rtol=0, atol=1e-5)


def test_one_beta_is_heard_over_all_of_its_range() -> None:
    """A number alone, brought to unit length, would say on which side of the middle it lies, and no more."""
    config = replace(SMALL, betas=1)
    generator = init_generator(config, jax.random.key(0))
    beta = jnp.array([[0.0], [0.25], [0.5], [0.75], [1.0]])
    w = map_latent(generator, jnp.ones((5, config.z)), beta)
    assert np.linalg.norm(np.diff(w, axis=0), axis=1).min() > 0.02 * float(jnp.linalg.norm(w[0]))
    assert np.isfinite(jax.jacobian(lambda b: map_latent(generator, jnp.ones((1, config.z)), b))(beta[2:3])).all()


def test_gradients_of_all_parameters_are_finite_and_none_is_dead() -> None:
    config = replace(SMALL, texels=16, layers=6)
    generator, averages = init_generator(config, jax.random.key(0)), init_averages(config)
    phases, z = draw_phases(config, jax.random.key(2), 1), jax.random.normal(jax.random.key(1), (1, 8))

    def loss(generator):
        w = map_latent(generator, z, jnp.zeros((1, 0)))
        texture = synthesise(config, generator, averages, w, phases, jnp.zeros(2, jnp.int32), (16, 16))
        return jnp.sum(texture.feature**2) + jnp.sum(synthesise_height(config, generator, w) ** 2)

    for path, leaf in jax.tree_util.tree_leaves_with_path(jax.jit(jax.grad(loss))(generator)):
        assert jnp.isfinite(leaf).all() and jnp.abs(leaf).max() > 0, jax.tree_util.keystr(path)
