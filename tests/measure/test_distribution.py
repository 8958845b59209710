"""KID and FID of sets whose distance is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm

from mesoshell.measure import distribution
from mesoshell.measure.distribution import fid, kid, with_interval


def gaussian(n: int, d: int, seed: int, shift: float = 0.0, scale: float = 1.0) -> np.ndarray:
    return shift + scale * np.random.default_rng(seed).normal(size=(n, d))


def test_a_set_is_at_no_distance_from_itself() -> None:
    x = gaussian(200, 12, 0)
    assert fid(x, x) == pytest.approx(0, abs=1e-10)
    assert fid(x, x[::-1]) == pytest.approx(0, abs=1e-10)
    assert abs(kid(x, gaussian(200, 12, 1))) < 0.03


@pytest.mark.parametrize(("shift", "scale"), [(0.5, 1.0), (0.0, 2.0), (1.0, 0.5)])
def test_fid_of_gaussians_is_the_closed_form(shift: float, scale: float) -> None:
    d = 4
    found = fid(gaussian(40_000, d, 0), gaussian(40_000, d, 1, shift, scale))
    assert found == pytest.approx(d * (shift**2 + (scale - 1) ** 2), rel=0.03)


@pytest.mark.parametrize("n", [6, 40])
def test_fid_is_the_definition_with_a_matrix_root(n: int) -> None:
    """More features than samples, and fewer: the sum of singular values is the trace of the root."""
    x, y = gaussian(n, 10, 2), gaussian(n + 3, 10, 3, 0.3, 1.4)
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = np.trace(np.real(sqrtm(a @ b + 1e-12 * np.eye(10))))
    expected = np.sum((x.mean(0) - y.mean(0)) ** 2) + np.trace(a + b) - 2 * root
    assert fid(x, y) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("block", [2, 1024])
def test_kid_is_the_definition_by_loops(block: int, monkeypatch) -> None:
    monkeypatch.setattr(distribution, "_BLOCK", block)
    x, y = gaussian(5, 3, 4), gaussian(7, 3, 5, 0.5)

    def k(a: np.ndarray, b: np.ndarray) -> float:
        return float((a @ b / 3 + 1) ** 3)

    def within(s: np.ndarray) -> float:
        return float(np.mean([k(s[i], s[j]) for i in range(len(s)) for j in range(len(s)) if i != j]))

    between = np.mean([k(a, b) for a in x for b in y])
    assert kid(x, y) == pytest.approx(within(x) + within(y) - 2 * between, rel=1e-12)


def test_kid_is_unbiased_and_covered_by_its_interval() -> None:
    """Over pairs of sets of one law the mean is 0, and most intervals hold 0."""
    pairs = [(gaussian(60, 8, 2 * s), gaussian(60, 8, 2 * s + 1)) for s in range(60)]
    found = [with_interval(kid, x, y) for x, y in pairs]
    values = np.array([e.value for e in found])
    assert abs(values.mean()) < 3 * values.std() / np.sqrt(60)
    assert np.mean([e.low <= 0 <= e.high for e in found]) > 0.85


@pytest.mark.parametrize("distance", [kid, fid])
def test_noise_takes_a_set_away_from_itself_step_by_step(distance) -> None:
    x, noise = gaussian(300, 16, 6), gaussian(300, 16, 7)
    found = [distance(x, x + s * noise) for s in (0.0, 0.7, 1.4, 2.8)]
    assert np.all(np.diff(found) > 0)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_neither_depends_on_the_axes_or_the_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(12, 5)), rng.normal(size=(9, 5)) + 0.3
    q = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    for distance in (kid, fid):
        assert distance(rng.permutation(x) @ q, y @ q) == pytest.approx(distance(x, y), abs=1e-9)
        assert distance(y, x) == pytest.approx(distance(x, y), abs=1e-9)


def test_one_picture_is_no_set() -> None:
    with pytest.raises(ValueError, match="at least two"):
        kid(np.zeros((1, 3)), np.zeros((5, 3)))
