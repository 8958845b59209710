"""The generator's operations at their extremes: styles, clamps, and places far from the origin.

Oracles: float64; and a texture at a far place is one at the origin whose phases are turned by f·x, exact in integers.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.shell.generator.generator import Phases, draw_phases, init_averages, init_generator, synthesise
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, frequencies_of
from mesoshell.signal.filtered_lrelu import CLAMP, GAIN, Activation, filtered_lrelu
from mesoshell.signal.modulated import modulated_conv
from mesoshell.signal.schedule import layer_schedule


@jax.jit
def convolved(x, w, s, g, seed):
    """A modulated convolution and its gradients."""
    y, back = jax.vjp(lambda x, w, s, g: modulated_conv(x, w, s, g, True, 0), x, w, s, g)
    return y, *back(seed)


@pytest.mark.parametrize("styles", [[0.0, 1e6, 1.0], [1e6, 1e6, -1e6], [1e-6, 0.0, -1e-6], [0.0, 0.0, 1e6]])
def test_demodulated_convolution_of_extreme_styles(styles: list[float]) -> None:
    """Value and gradients against float64: demodulation takes the styles' scale away."""
    rng = np.random.default_rng(0)
    x, w, seed = (rng.normal(size=n).astype(np.float32) for n in ((1, 6, 6, 3), (3, 3, 3, 4), (1, 4, 4, 4)))
    s, g = np.array([styles], np.float32), np.ones((), np.float32)

    found = convolved(x, w, s, g, seed)
    with jax.enable_x64(True):
        true = [np.asarray(v) for v in convolved(*(np.asarray(v, np.float64) for v in (x, w, s, g, seed)))]
    for a, b in zip(found, true, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5 * np.abs(b).max() + 1e-30)


@pytest.mark.parametrize("tiny", [0.0, 1e-25])
def test_convolution_of_styles_and_weights_that_are_nothing(tiny: float) -> None:
    """A sample's styles, and one channel's weights: finite values and gradients."""
    rng = np.random.default_rng(1)
    x, w = (jnp.asarray(rng.normal(size=n), jnp.float32) for n in ((2, 6, 6, 3), (3, 3, 3, 4)))
    s = jnp.ones((2, 3)).at[0].set(tiny)
    y, *slopes = convolved(x, w.at[..., 1].set(tiny), s, jnp.ones(()), jnp.ones((2, 4, 4, 4)))
    assert all(jnp.isfinite(v).all() for v in (y, *slopes))
    assert jnp.abs(y[0]).max() < 1e-6 and jnp.abs(y[1, ..., 1]).max() < 1e-6 and jnp.abs(y[1, ..., 0]).max() > 0.1


@jax.jit
def activated(x):
    """A filtered activation and its gradient."""
    how = Activation(layer_schedule(32, "T")[4], (0, 0, 0, 0))
    y, back = jax.vjp(lambda x: filtered_lrelu(x, how), x)
    return y, back(jnp.ones_like(y))[0]


@pytest.mark.parametrize("times", [1.0, 1 + 1e-6, 1e3, 1e35])
@pytest.mark.parametrize("sign", [1.0, -5.0])
def test_activation_at_its_clamp(times: float, sign: float) -> None:
    """A constant is what it is after filtering: bent, held within ±256, with a finite gradient."""
    y, slope = activated(jnp.full((1, 24, 24, 1), sign * times * CLAMP / GAIN, jnp.float32))
    np.testing.assert_allclose(y[:, 6:-6, 6:-6], np.sign(sign) * CLAMP, rtol=2e-2)
    assert jnp.isfinite(y).all() and jnp.isfinite(slope).all()


@pytest.mark.parametrize("tile", [(2**20, -(2**20)), pytest.param((-(2**20) + 1, 2**20 - 7), marks=pytest.mark.slow)])
def test_a_texture_65536_patches_away(tile: tuple[int, int]) -> None:
    config = GeneratorConfig(16, "T", 32, 4, 4, 4, drift=1.5, z=4, w=4, height_rows=8, height_width=4)
    generator, averages = init_generator(config, jax.random.key(0)), init_averages(config)
    w, phases = jax.random.normal(jax.random.key(1), (1, 4)), draw_phases(config, jax.random.key(2), 1)

    f = frequencies_of(config)

    def turned(phase: jax.Array, frequencies: np.ndarray) -> jax.Array:
        x = [Fraction(at, CELL) for at in tile]
        step = [sum(Fraction(int(m), 2**16) * v for m, v in zip(row, x, strict=True)) for row in frequencies]
        slow = [Fraction(int(m), 2**16) * v for axis, v in zip(f.slow.T, x, strict=True) for m in axis]
        cycles = np.array([[float(c % 1) for c in step]] + [[float(c % 1)] * len(step) for c in slow])
        return jnp.asarray(np.asarray(phase, np.float64) + cycles[None], jnp.float32)

    moved = Phases(turned(phases.input, f.input), [turned(p, m) for p, m in zip(phases.layers, f.layers, strict=True)])
    run = jax.jit(lambda phases, tile: synthesise(config, generator, averages, w, phases, tile, (16, 16)).feature)
    far, near = run(phases, jnp.array(tile, jnp.int32)), run(moved, jnp.zeros(2, jnp.int32))
    assert float(jnp.std(near)) > 1e-3
    np.testing.assert_allclose(far, near, rtol=0, atol=2e-5 * float(jnp.abs(near).max()))
