"""Distances between two sets of features: KID and FID; means with intervals (NumPy and SciPy).

symbol  meaning                                                                   shape
X, Y    features of N and M pictures                                              (N, D), (M, D)
k(x, y) (x·y / D + 1)³                                                            Bińkowski et al. 2018
KID     unbiased square of the maximum mean discrepancy under k; may be negative
FID     |μ_X − μ_Y|² + tr(Σ_X + Σ_Y − 2 (Σ_X Σ_Y)^½)                              Heusel et al. 2017
halves  the same estimate on random halves of both sets: their standard deviation is about that of the whole estimate, of
        independent pictures. It is up to twice as wide for a KID near 0, whose variance falls as 1/N², and too narrow where
        many pictures are of one patch

FID is biased upward by a few times D/N: compare only numbers of equal N. The trace of the square root is the sum of the
singular values of A Bᵀ, with A and B the centred features over √(N − 1): no root of a D × D matrix, which is singular for
N ≤ D.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

HALVES = 24
#: Rows whose products with all others are held at once.
_BLOCK = 1024


class Estimate(NamedTuple):
    """A value with its 95% interval."""

    value: float
    low: float
    high: float


def mean_with_interval(rows: Float[np.ndarray, "N K"]) -> list[Estimate]:
    """Means of columns, with the 95% interval of Student's t. One row tells no interval: its ends are the value."""
    count = len(rows)
    reach = np.zeros(rows.shape[1])
    if count > 1:
        reach = student.ppf(0.975, count - 1) * rows.std(axis=0, ddof=1) / np.sqrt(count)
    return [Estimate(float(m), float(m - r), float(m + r)) for m, r in zip(rows.mean(axis=0), reach, strict=True)]


def kid(x: Float[np.ndarray, "N D"], y: Float[np.ndarray, "M D"]) -> float:
    """KID of two sets of at least two. Raises ValueError for fewer."""
    _check(x, y)
    return _mean_apart(x) + _mean_apart(y) - 2 * _kernel_sum(x, y) / (len(x) * len(y))


def fid(x: Float[np.ndarray, "N D"], y: Float[np.ndarray, "M D"]) -> float:
    """FID of two sets of at least two. Raises ValueError for fewer."""
    _check(x, y)
    (mx, a), (my, b) = _centred(x), _centred(y)
    both = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    return float(np.sum((mx - my) ** 2) + np.sum(a**2) + np.sum(b**2) - 2 * both)


def with_interval(
    distance: Callable[[np.ndarray, np.ndarray], float],
    x: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, "M D"],
    seed: int = 0,
) -> Estimate:
    """A distance with its interval, ±1.96 standard deviations over halves. Those of a biased distance are farther apart: only
    their spread is used."""
    rng = np.random.default_rng(seed)
    value = distance(x, y)
    halves = [distance(_half(rng, x), _half(rng, y)) for _ in range(HALVES)]
    reach = 1.96 * float(np.std(halves, ddof=1))
    return Estimate(value, value - reach, value + reach)


def _half(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    return x[rng.choice(len(x), max(2, len(x) // 2), replace=False)]


def _kernel_sum(x: np.ndarray, y: np.ndarray) -> float:
    """Sum of k over all pairs, by blocks of x, whose products are held at once."""
    x, y = x.astype(np.float64), y.astype(np.float64)
    blocks = (x[i : i + _BLOCK] for i in range(0, len(x), _BLOCK))
    return float(sum(((a @ y.T / x.shape[1] + 1) ** 3).sum() for a in blocks))


def _mean_apart(x: np.ndarray) -> float:
    """Mean of k over pairs of different rows."""
    own = float(((np.sum(x.astype(np.float64) ** 2, axis=1) / x.shape[1] + 1) ** 3).sum())
    return (_kernel_sum(x, x) - own) / (len(x) * (len(x) - 1))


def _centred(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean, and a matrix A with AᵀA = Σ, of at most D rows."""
    exact = x.astype(np.float64)
    mean = exact.mean(axis=0)
    a = (exact - mean) / np.sqrt(len(x) - 1)
    return mean, np.asarray(np.linalg.qr(a, mode="r")) if len(a) > a.shape[1] else a


def _check(x: np.ndarray, y: np.ndarray) -> None:
    if min(len(x), len(y)) < 2 or x.shape[1:] != y.shape[1:]:
        raise ValueError(f"needs two sets of at least two features of one size, not {x.shape} and {y.shape}")
