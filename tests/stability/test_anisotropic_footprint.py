"""Hard case 15: long footprints at the horizon, one tap and sixteen along the major axis.

Oracle: 4096 taps of the ellipse's Gaussian along its major axis, ±4 standard deviations, each filtered as wide as the minor
axis. Textures are random: white, and 1/f as in nature. Errors are root mean squares over places, relative to the texture's
standard deviation; the bound at 16 taps is 2%. `record_property` keeps them for the reports of pytest.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.nets.mlp import Dense
from mesoshell.shell.geometry.sampling import Chart
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material
from mesoshell.shell.material.loader import Grid
from mesoshell.shell.render import kernels
from mesoshell.shell.render.kernels import DeviceTables, StaticConfig, gaussian_taps
from mesoshell.texture import mip
from mesoshell.texture.footprint import Footprint, footprint

SIDE, PLACES, ELEVATION = 128, 48, np.radians(1.0)
SIZES = mip.level_sizes(SIDE, SIDE)
BOUND = 0.02


def texture(power: float) -> np.ndarray:
    """Random texture (SIDE, SIDE, 4) with spectrum 1/fᵖ, mean 0, standard deviation 1."""
    noise = np.random.default_rng(3).normal(size=(SIDE, SIDE, 4))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE)))
    f[0, 0] = np.inf if power else 1
    image = np.fft.ifft2(np.fft.fft2(noise, axes=(0, 1)) / f[..., None] ** power, axes=(0, 1)).real
    return ((image - image.mean()) / image.std()).astype(np.float32)


def table(feature: np.ndarray) -> DeviceTables:
    """A table whose decoder inputs begin with the filtered texture itself."""
    none, one = Dense(jnp.zeros((1, 1)), jnp.zeros(1)), jnp.ones(())
    material = Material(
        mip.pack(mip.build(jnp.asarray(feature))),
        mip.pack([jnp.zeros((1, 1, 4))]),
        Decoder([], none, [], none, one),
    )
    chart = Chart(jnp.zeros((1, 18)), jnp.zeros((1, 6)))
    return DeviceTables(chart, material, Grid(jnp.zeros(1)), jnp.zeros(0), (), one, one, one)


def at_horizon(texels: float, ratio: float) -> Footprint:
    """The footprint of a step seen under ELEVATION, `texels` across and `ratio` times as long."""
    across = texels / SIDE
    along = across * ratio / np.cos(ELEVATION)
    d = jnp.float32([np.cos(ELEVATION) * 0.8, np.cos(ELEVATION) * 0.6, np.sin(ELEVATION)])
    return footprint(jnp.eye(3), d, jnp.float32(along**2), jnp.float32(across**2))


def filtered(feature: np.ndarray, uv: np.ndarray, f: Footprint, taps: int) -> np.ndarray:
    program = StaticConfig(Layout(SIZES, ((1, 1),), float(SIDE), 0), ((1, 1, 1),), True, taps, False, ())
    xi = jnp.concatenate([jnp.asarray(uv), jnp.full((len(uv), 1), 0.5)], axis=1)
    found = jax.jit(jax.vmap(lambda x: kernels._inputs(program, table(feature), x, f)))(xi)
    return np.asarray(found)[:, :4]


def supersampled(feature: np.ndarray, uv: np.ndarray, f: Footprint) -> np.ndarray:
    x = (np.arange(4096) + 0.5) / 4096 * 8 - 4
    weights = np.exp(-x * x / 2) / np.exp(-x * x / 2).sum()
    reach = np.sqrt(
        float(f.major) ** 2 - float(f.minor) ** 2
    )  # a tap is as wide as the minor axis along the major one, too
    pyramid = mip.pack(mip.build(jnp.asarray(feature)))
    level = mip.level_of(f.minor, float(SIDE), len(SIZES) - 1)
    at = uv[:, None] + (x[:, None] * reach * np.asarray(f.axis)).astype(np.float32)
    look = jax.vmap(lambda where: mip.lookup(pyramid, SIZES, where, level))
    found = look(jnp.asarray(at.reshape(-1, 2)))
    return np.einsum("k,pkc->pc", weights, np.asarray(found).reshape(len(uv), 4096, 4))


BEYOND = pytest.mark.xfail(
    strict=True, raises=AssertionError, reason="no 16 round taps were found that hold 2% beyond 8 : 1"
)


@pytest.mark.parametrize("power", [0.0, 1.0])
@pytest.mark.parametrize("ratio", [2.0, 4.0, 8.0, pytest.param(32.0, marks=BEYOND)])
def test_sixteen_taps_against_4096(power: float, ratio: float, record_property):
    feature, f = texture(power), at_horizon(1.0, ratio)
    uv = np.random.default_rng(4).uniform(size=(PLACES, 2)).astype(np.float32)
    true = supersampled(feature, uv, f)
    error = {n: float(np.sqrt(np.mean((filtered(feature, uv, f, n) - true) ** 2))) for n in (1, 16)}
    for n, value in error.items():
        record_property(f"error at {n} taps, ratio {ratio:g}, spectrum 1/f^{power:g}", value)
        print(f"{n:2d} taps, ratio {ratio:g}, spectrum 1/f^{power:g}: {value:.2%}")
    assert error[16] < error[1]
    assert error[16] <= BOUND


def test_the_footprint_is_as_long_as_asked():
    f = at_horizon(1.0, 8.0)
    np.testing.assert_allclose([f.minor * SIDE, f.major * SIDE], [1, 8], rtol=1e-4)
    np.testing.assert_allclose(np.abs(np.asarray(f.axis)), [0.8, 0.6], rtol=1e-3)


@pytest.mark.parametrize("n", [1, 2, 4, 16])
def test_taps_have_mean_0_variance_1_and_weight_1(n: int):
    x, w = (np.asarray(a, np.float64) for a in gaussian_taps(n))
    np.testing.assert_allclose([w.sum(), w @ x, w @ x**2], [1, 0, float(n > 1)], atol=1e-6)


def test_a_round_footprint_is_one_tap():
    uv = np.random.default_rng(6).uniform(size=(8, 2)).astype(np.float32)
    f = Footprint(jnp.float32(0.02), jnp.float32(0.02), jnp.float32([1, 0]), jnp.float32(0))
    np.testing.assert_allclose(filtered(texture(0.0), uv, f, 16), filtered(texture(0.0), uv, f, 1), atol=1e-6)


def test_a_footprint_of_no_size_has_finite_gradients():
    def value(minor, major):
        f = Footprint(minor, major, jnp.float32([1, 0]), jnp.float32(0))
        program = StaticConfig(Layout(SIZES, ((1, 1),), float(SIDE), 0), ((1, 1, 1),), True, 16, False, ())
        return kernels._inputs(program, table(texture(1.0)), jnp.float32([0.3, 0.4, 0.5]), f).sum()

    slope = jax.jit(jax.grad(value, (0, 1)))
    for minor, major in ((0.0, 0.0), (0.0, 0.1), (0.1, 0.1), (0.1, 1e3)):
        assert np.isfinite(slope(jnp.float32(minor), jnp.float32(major))).all()
