"""Textures follow their maps; the interpolation that they are compared with follows waves."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.measure import equivariance
from mesoshell.measure.equivariance import eq_r, eq_t
from mesoshell.shell.generator.generator import (
    Averages,
    Generator,
    Phases,
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
)
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.typing import Array


def drawn(config: GeneratorConfig) -> tuple[GeneratorConfig, tuple[Generator, Averages], Array, Phases]:
    generator = init_generator(config, jax.random.key(0))
    w = map_latent(generator, jax.random.normal(jax.random.key(1), (1, config.z)), jnp.zeros((1, 0)))
    return config, (generator, init_averages(config)), w, draw_phases(config, jax.random.key(2), 1)


def of(metric, made, moved) -> float:
    config, maker, w, phases = made
    return metric(config, maker, w, phases, moved)


@pytest.fixture(scope="module")
def random(request):
    return drawn(GeneratorConfig(64, request.param, 512, 8, channels=4, z=8, w=8))


def of_config(*default: str):
    """A test of both, which runs each time with those that are given."""
    each = [name if name in default else pytest.param(name, marks=pytest.mark.slow) for name in ("T", "R")]
    return pytest.mark.parametrize("random", each, indirect=True)


@pytest.mark.slow  # test_generator asks the same of the texture
@of_config("T")
def test_whole_texels_are_fractions_of_inner_samples_and_lose_nothing(random: Any) -> None:
    assert of(eq_t, random, (1.0, 3.0)) > 55  # 59 to 75 measured; the least that is asked for is 45


@of_config("T")
def test_parts_of_a_texel_lose_what_lies_near_half_the_rate(random: Any) -> None:
    assert of(eq_t, random, (0.4, 1.7)) > 28


@pytest.mark.slow
@of_config("R")
def test_turning_is_for_config_r(random: Any) -> None:
    """90° takes the grid to itself: exact where filters are round and kernels 1 × 1, nonsense where they are not."""
    quarter = of(eq_r, random, 90.0)
    assert quarter > 75 if random[0].config == "R" else quarter < 20
    assert of(eq_r, random, 33.0) > (15 if random[0].config == "R" else 0)


@pytest.mark.parametrize("frequency", [0.1, 0.2, 0.3])
def test_the_interpolation_follows_waves(frequency: float, monkeypatch) -> None:
    """frequency in cycles a texel, the rate's half being 0.5."""
    angle = 0.7

    def texture(config: GeneratorConfig, maker, w, phases) -> np.ndarray:
        turn, by = np.radians(config.turn), phases.input[0, 0, 0]
        v, u = np.mgrid[:192, :192] + 0.5 - 96
        f = frequency * np.array([np.cos(angle + turn), np.sin(angle + turn)])
        return np.sin(2 * np.pi * (f[0] * v + f[1] * u - float(by) + 0.2))[..., None]

    monkeypatch.setattr(equivariance, "_texture", texture)
    made: Any = drawn(GeneratorConfig(64, "T", 64, 4, channels=4, layers=4, z=4, w=4))
    assert of(eq_r, made, 33.0) > 45
