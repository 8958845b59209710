"""The reader: linear parameters are read, others are not, and pictures left out are left out as by learning again."""

import numpy as np
import pytest

from mesoshell.measure import reader
from mesoshell.measure.reader import error, learn, read


def data(n: int, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(n)
    x = rng.normal(size=(n, 300)) * np.linspace(0.5, 3, 300) + 2
    t = np.stack([x[:, :6].sum(axis=1) / 10, rng.uniform(size=n)], axis=1)
    return x, t + noise * rng.normal(size=t.shape)


def test_what_the_features_tell_is_read_and_nothing_else() -> None:
    (x, t), (y, s) = data(500), data(400)
    missed = error(read(learn(x, t), y), s)
    spread = s.std(axis=0)
    assert missed[0] < 0.6 * spread[0] and missed[1] > 0.95 * spread[1]
    assert missed[1] < 1.1 * spread[1]  # it says the mean rather than what it has by heart


def test_leaving_one_out_is_learning_without_it(monkeypatch) -> None:
    """The ridge is chosen by the error of n models, each learned from the others: two candidates, both by hand."""
    x, t = data(12)
    x, t = x[:, :8], t[:, :1]
    a, b = (x - x.mean(axis=0)) / x.std(axis=0), t - t.mean(axis=0)
    scores = []  # with a mean of the others alone, and the deviations of all
    for ridge in (1e-3, 3.0):
        total = 0.0
        for i in range(len(x)):
            keep = np.arange(len(x)) != i
            ours, theirs = (y[keep] - y[keep].mean(axis=0) for y in (a, b))
            w = np.linalg.solve(ours.T @ ours / 8 + ridge * np.eye(8), ours.T @ theirs / 8)
            total += float(((a[i] - a[keep].mean(axis=0)) @ w - b[i] + b[keep].mean(axis=0))[0] ** 2)
        scores.append(total)
    chosen = (1e-3, 3.0)[int(np.argmin(scores))]
    monkeypatch.setattr(reader, "RIDGES", np.array([1e-3, 3.0]))
    both = learn(x, t).weights
    monkeypatch.setattr(reader, "RIDGES", np.array([chosen]))
    np.testing.assert_allclose(both, learn(x, t).weights)
    w = np.linalg.solve(a.T @ a / 8 + chosen * np.eye(8), a.T @ b / 8) / x.std(axis=0)[:, None]
    np.testing.assert_allclose(both, w, rtol=1e-9)
    assert read(learn(x, t), x).mean() == pytest.approx(t.mean())


@pytest.mark.parametrize("n", [60, 100])
def test_with_more_features_than_pictures_nothing_is_told_from_the_others_sum(n: int) -> None:
    """The ridge with the least error on unseen pictures is not the smallest: one near it is chosen."""
    (x, t), (y, s) = data(n, noise=0.3), data(400)
    errors = []
    for ridge in reader.RIDGES:
        a, b = (x - x.mean(axis=0)) / x.std(axis=0), t - t.mean(axis=0)
        w = a.T @ np.linalg.solve(a @ a.T / 300 + ridge * np.eye(n), b) / 300 / x.std(axis=0)[:, None]
        errors.append(error((y - x.mean(axis=0)) @ w + t.mean(axis=0), s))
    chosen = error(read(learn(x, t), y), s)
    assert chosen[1] < 1.1 * np.array(errors)[:, 1].min() < 0.98 * errors[0][1]
