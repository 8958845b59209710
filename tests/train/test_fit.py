"""A fit recovers fog, an interrupted fit ends where the uninterrupted one does, and decoding less changes no ray's value."""

from dataclasses import replace
from pathlib import Path

import fog
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mesoshell.io.dataset import Dataset
from mesoshell.train import loop
from mesoshell.train.fit import Batch, FitConfig, State, predict, residual, start
from mesoshell.train.holdout import score
from mesoshell.train.rays import RayTable, image_table, ray_table
from mesoshell.typing import Scalar

CONFIG = FitConfig(
    texels=4, channels=4, height_rows=4, octaves=1, trunk=(16,), head=(16,), rays=128, candidates=16, decoded=1.0
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return fog.write(tmp_path_factory.mktemp("fog") / "train", fog.CAMERAS)


def test_fog_is_recovered_in_views_not_seen(dataset: Dataset, tmp_path: Path):
    state = loop.fit(CONFIG, ray_table(dataset), image_table(dataset), 200, tmp_path)
    unseen = fog.write(tmp_path / "unseen", [(2.2, 1.9, 2.0)])
    scores, pictures = score(CONFIG, state, unseen)
    assert scores.alpha > 35 and scores.foreground > 35
    assert pictures.shape == (1, fog.SIZE, fog.SIZE, 4)


def test_an_interrupted_fit_goes_on(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    tables = ray_table(dataset), image_table(dataset)
    whole = loop.fit(CONFIG, *tables, 12, tmp_path / "whole")
    monkeypatch.setattr(loop, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(loop, "LOG_EVERY", 5)

    def stop(row: dict, state: State) -> None:
        if row["step"] == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        loop.fit(CONFIG, *tables, 12, tmp_path / "parts", stop)
    resumed = loop.fit(CONFIG, *tables, 12, tmp_path / "parts")
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(a, b)
    again = loop.fit(CONFIG, *tables, 12, tmp_path / "parts")  # nothing is left to do
    np.testing.assert_array_equal(again.parameters.feature, resumed.parameters.feature)


def some_rays(dataset: Dataset) -> Batch:
    table, images = ray_table(dataset), image_table(dataset)
    spread = np.linspace(0, len(table.image) - 1, CONFIG.rays).astype(int)
    rays = RayTable(*(jnp.asarray(x[spread]) for x in table))
    rays = rays._replace(radius=0.01 * rays.radius)  # no filter as wide as a cell: those are always decoded
    light, irradiance, alpha = (jnp.asarray(x)[rays.image] for x in images)
    return Batch(rays, light, irradiance, alpha)


def test_a_smaller_budget_leaves_rays_out_and_changes_none(dataset: Dataset):
    state = start(CONFIG, image_table(dataset), 1)
    batch, jitter = some_rays(dataset), jnp.full((CONFIG.rays, CONFIG.candidates), 0.5)
    full, complete, _ = predict(CONFIG, state.parameters, batch, state.occupancy, jitter)
    assert bool(complete.all())
    half, kept, wanted = predict(replace(CONFIG, decoded=0.5), state.parameters, batch, state.occupancy, jitter)
    assert 0 < int(kept.sum()) < CONFIG.rays and float(wanted) == pytest.approx(2.0, rel=0.05)
    long = kept & (full[:, 3] > 0.3)  # no candidate of theirs is too short to matter
    np.testing.assert_allclose(half[long], full[long], rtol=1e-5, atol=1e-6)


def test_empty_cells_are_not_decoded(dataset: Dataset):
    state = start(CONFIG, image_table(dataset), 1)
    empty = state.occupancy.at[16:].set(0.0)  # the upper half
    batch, jitter = some_rays(dataset), jnp.full((CONFIG.rays, CONFIG.candidates), 0.5)
    y, complete, wanted = predict(replace(CONFIG, decoded=0.99), state.parameters, batch, empty, jitter)
    all_, _, _ = predict(CONFIG, state.parameters, batch, state.occupancy, jitter)
    assert 0.5 < float(wanted) < 1.5  # half of the candidates, over a budget of half of them
    assert (y[complete, 3] < all_[complete, 3] - 1e-3).mean() > 0.5


def test_the_best_answer_for_pixels_that_look_alike_is_their_mean():
    """Of radiance, not of x/(1+x), whose mean is 0.57 here in place of 1.05; small differences are those of y."""
    target = jnp.asarray([[tonemapped(x)] * 3 + [1.0] for x in (0.1, 2.0)], jnp.float32)

    def loss(x: Scalar) -> Scalar:
        y = jnp.broadcast_to(jnp.append(jnp.full(3, x / (1 + x)), 1.0), (2, 4))
        return jnp.mean(jnp.square(residual(y, target)))

    slopes = [float(jax.grad(loss)(jnp.asarray(x, jnp.float32))) for x in (1.04, 1.05, 1.06)]
    assert slopes[0] < -1e-4 < slopes[1] < 1e-4 < slopes[2]
    y = target + jnp.asarray([[1e-3, -1e-3, 0, 1e-3]] * 2, jnp.float32)
    np.testing.assert_allclose(residual(y, target), y - target, rtol=5e-3, atol=1e-6)


@pytest.mark.parametrize("target", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("predicted", [0.0, 0.5, 1.0])
def test_infinite_radiance_is_a_bounded_error(predicted: float, target: float):
    """y is 1 from 2e7 on in single precision: a firefly, or a prediction that diverged."""
    y, true = (jnp.full(4, v, jnp.float32) for v in (predicted, target))
    error, gradient = jax.value_and_grad(lambda y: jnp.sum(jnp.square(residual(y, true))))(y)
    assert np.isfinite(error) and np.isfinite(np.asarray(gradient)).all() and float(error) < 1e5


def tonemapped(x: float) -> float:
    return x / (1 + x)
