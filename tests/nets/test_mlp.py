"""Dense networks: tiles against one plain evaluation, for counts that are no multiples of a tile, against NumPy in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.nets.mlp import TILE, Dense, apply_relu, in_tiles, init_dense, init_mlp


def network() -> list[Dense]:
    return init_mlp(jax.random.key(0), (5, 8, 3))


def true_relu(layers: list[Dense], x: np.ndarray) -> np.ndarray:
    for layer in layers:
        x = np.maximum(x @ np.asarray(layer.kernel, np.float64) + np.asarray(layer.bias, np.float64), 0)
    return x


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("count", [0, 1, TILE - 1, TILE, TILE + 1, 2 * TILE])
def test_tiles_are_the_plain_evaluation(count: int, backend: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    layers = network()
    x = np.random.default_rng(1).normal(size=(2 * TILE, 5)).astype(np.float32)

    @jax.jit
    def tiled(x, count):
        like = ((3, jnp.float32), (0, jnp.float32))
        return in_tiles(lambda x: (apply_relu(layers, x), x.sum(axis=1)), count, (x,), like)

    found, sums = tiled(x, np.int32(count))
    assert found.shape == (2 * TILE, 3) and sums.shape == (2 * TILE,)
    np.testing.assert_allclose(found[:count], true_relu(layers, x)[:count], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(sums[:count], x.sum(axis=1)[:count], rtol=1e-4, atol=1e-5)
    if backend == "cpu":  # which does nothing for further tiles
        assert not np.asarray(found[-(-count // TILE) * TILE :]).any()


def test_one_program_serves_every_count():
    traces = []

    @jax.jit
    def tiled(x, count):
        traces.append(count)
        return in_tiles(lambda x: (2 * x,), count, (x,), ((2, jnp.float32),))

    x = np.ones((2 * TILE, 2), np.float32)
    for count in (0, 7, TILE + 1):
        tiled(x, np.int32(count))
    assert len(traces) == 1


def test_initial_variance_is_gain_over_inputs():
    layer = init_dense(jax.random.key(2), 400, 300, gain=2.0)
    np.testing.assert_allclose(np.var(np.asarray(layer.kernel)), 2 / 400, rtol=0.02)
    assert not np.asarray(layer.bias).any()


def test_layers_chain():
    assert [layer.kernel.shape for layer in init_mlp(jax.random.key(3), (4, 8, 8, 2))] == [(4, 8), (8, 8), (8, 2)]
    assert init_mlp(jax.random.key(3), (4,)) == []
