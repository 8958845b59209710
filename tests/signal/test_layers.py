"""A whole layer (modulated convolution, filtered leaky ReLU) against the published generator's, and its derivatives."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from mesoshell.signal import blocks, modulated
from mesoshell.signal.filtered_lrelu import (
    Activation,
    along_axes,
    filtered_lrelu,
    in_blocks,
    separable,
)
from mesoshell.signal.modulated import modulated_conv
from mesoshell.signal.schedule import LayerRow, layer_schedule
from tests.helpers.definitions import filtered_lrelu_plain, modulated_conv_plain

DATA = Path(__file__).parent.parent / "data/aliasfree"
LAYERS = [("T64", 0), ("T64", 5), ("T64", 13), ("T64", 14), ("R64", 4), ("R64", 8), ("R64", 14)]


def small(row: LayerRow) -> Activation:
    """The row's activation for inputs of any size, its padding as in training at a fixed size."""
    left, right, top, bottom = row.padding
    return Activation(row, (left, right, top, bottom))


@pytest.mark.parametrize(("name", "index"), LAYERS)
@pytest.mark.parametrize(
    ("convolution", "activation"),
    [
        pytest.param(modulated_conv_plain, filtered_lrelu_plain, marks=pytest.mark.slow),
        (modulated_conv, filtered_lrelu),
    ],
)
def test_is_the_published_layer(name: str, index: int, convolution, activation) -> None:
    row = layer_schedule(int(name[1:]), "T" if name[0] == "T" else "R")[index]
    with np.load(DATA / f"layers_{name}.npz") as file:
        a = {key.split("_", 1)[1]: file[key] for key in file.files if key.startswith(f"L{index}_")}
    style = a["w"] @ a["affine_weight"].T / np.sqrt(a["w"].shape[1]) + a["affine_bias"]
    if row.is_torgb:
        style = style / np.sqrt(len(a["affine_weight"]))
    x, w = jnp.asarray(a["x"].transpose(0, 2, 3, 1)), jnp.asarray(a["weight"].transpose(2, 3, 1, 0))
    gain = jnp.asarray(1 / np.sqrt(a["magnitude_ema"]))

    @jax.jit
    def layer(x, w, style, gain, bias):
        y = convolution(x, w, style, gain, not row.is_torgb, row.conv_kernel - 1)
        return activation(y + bias[None, None, None], small(row))

    y = layer(x, w, jnp.asarray(style), gain, jnp.asarray(a["bias"]))
    expected = a["y"].transpose(0, 2, 3, 1)
    np.testing.assert_allclose(y, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(("config", "index"), [("T", 0), ("T", 4), ("T", 13), ("T", 14), ("R", 0), ("R", 4), ("R", 13)])
def test_fast_and_plain_agree_in_value_and_gradient(config, index: int) -> None:
    row = layer_schedule(32, config)[index]
    how = small(row)
    rng = np.random.default_rng(index)
    with jax.enable_x64(True):
        x = jnp.asarray(rng.normal(size=(1, 34, 37, 2)))
        seed = jnp.asarray(rng.normal(size=jax.eval_shape(lambda x: filtered_lrelu_plain(x, how), x).shape))

        def value_and_gradient(activation):
            value, back = jax.vjp(lambda x: activation(x, how), x)
            return value, back(seed)[0]

        fast, plain = jax.jit(lambda: tuple(map(value_and_gradient, (filtered_lrelu, filtered_lrelu_plain))))()
        for found, expected in zip(fast, plain, strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("config", "index"), [("T", 1), ("T", 5), ("R", 0), ("R", 5)])
@pytest.mark.parametrize("shape", [(2, 34, 37, 5), pytest.param((1, 29, 24, 13), marks=pytest.mark.slow)])
@pytest.mark.parametrize("padding", [None, (0, 0, 0, 0), (3, 1, -5, 2)])
def test_blocks_are_parts_of_the_whole(config, index: int, shape, padding, monkeypatch) -> None:
    """Several blocks of rows and of channels, the last of them cut short, at any padding."""
    monkeypatch.setattr(blocks, "ROWS", 6)
    monkeypatch.setattr(blocks, "CHANNELS", 8)
    row = layer_schedule(32, config)[index]
    how = Activation(row, padding or small(row).pad)
    with jax.enable_x64(True):
        x = jnp.asarray(np.random.default_rng(index).normal(size=shape))
        parts, whole = jax.jit(lambda x: (in_blocks(x, how), along_axes(x, how)))(x)
        np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize("activation", [filtered_lrelu, filtered_lrelu_plain])
@pytest.mark.parametrize(("config", "index"), [("T", 4), ("R", 0)])
def test_activation_against_finite_differences(config, index: int, activation) -> None:
    how = small(layer_schedule(32, config)[index])
    with jax.enable_x64(True):
        x = jnp.asarray(np.random.default_rng(3).normal(size=(1, 9, 8, 1)))
        check_grads(jax.jit(lambda x: activation(x, how)), (x,), order=1, modes=["rev"], eps=1e-7, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("convolution", [modulated_conv, modulated_conv_plain])
@pytest.mark.parametrize("demodulate", [True, False])
def test_convolution_against_finite_differences(convolution, demodulate: bool) -> None:
    rng = np.random.default_rng(4)
    with jax.enable_x64(True):
        x, w = jnp.asarray(rng.normal(size=(2, 5, 4, 3))), jnp.asarray(rng.normal(size=(3, 3, 3, 2)))
        s, g = jnp.asarray(rng.normal(size=(2, 3))), jnp.asarray(0.7)
        check_grads(
            jax.jit(lambda *a: convolution(*a, demodulate, 0)),
            (x, w, s, g),
            order=1,
            modes=["rev"],
            atol=1e-6,
            rtol=1e-6,
        )


@pytest.mark.parametrize("size", [(3, 3), (5, 40), (70, 33)])
def test_convolution_by_rows_is_the_librarys_in_value_and_gradient(size: tuple[int, int], monkeypatch) -> None:
    monkeypatch.setattr(modulated, "_BLOCK", 2000)  # several blocks, the last of them cut short
    rng = np.random.default_rng(6)
    with jax.enable_x64(True):
        x, w = jnp.asarray(rng.normal(size=(2, *size, 4))), jnp.asarray(rng.normal(size=(3, 3, 4, 5)))
        seed = jnp.asarray(rng.normal(size=jax.eval_shape(modulated.by_library, x, w).shape))

        def value_and_gradient(convolution):
            value, back = jax.vjp(convolution, x, w)
            return value, back(seed)

        ways = modulated.by_rows, modulated.by_library
        (a, back_a), (b, back_b) = jax.jit(lambda: tuple(map(value_and_gradient, ways)))()
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
        for found, expected in zip(back_a, back_b, strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_demodulated_output_has_unit_size_for_noise() -> None:
    """White noise of unit variance keeps it, whatever weights and styles are."""
    rng = np.random.default_rng(5)
    x = jnp.asarray(rng.normal(size=(2, 40, 40, 32)), jnp.float32)
    w, s = (
        jnp.asarray(rng.normal(size=(3, 3, 32, 16)) * 40, jnp.float32),
        jnp.asarray(rng.normal(size=(2, 32)), jnp.float32),
    )
    y = jax.jit(modulated_conv, static_argnums=(4, 5))(x, w, s, jnp.asarray(1.0, jnp.float32), True, 0)
    np.testing.assert_allclose(jnp.std(y, axis=(1, 2)), 1, rtol=0.15)


@pytest.mark.parametrize("value", [0.0, 1e30, -1e30, 1e-40])
def test_activation_of_extremes_is_finite(value: float) -> None:
    how = small(layer_schedule(32, "T")[0])
    x = jnp.full((1, 10, 10, 1), value, jnp.float32)

    @jax.jit
    def value_and_gradient(x):
        y, back = jax.vjp(lambda x: filtered_lrelu(x, how), x)
        return y, back(jnp.ones_like(y))[0]

    assert all(np.isfinite(found).all() for found in value_and_gradient(x))


def test_a_radial_filter_is_six_products() -> None:
    row = layer_schedule(64, "R")[0]
    assert row.down_filter is not None
    parts = separable(row.down_filter)
    assert len(parts) <= 6
    np.testing.assert_allclose(sum(np.outer(h, g) for g, h in parts), row.down_filter, rtol=0, atol=1e-15)
