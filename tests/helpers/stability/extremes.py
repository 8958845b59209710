"""Numbers at the ends of their ranges, and what is true of them in higher precision."""

import mpmath
import numpy as np

SIGMAS = [0.0, 1e-30, 1e-12, 1e-3, 1.0, 50.0, 1e7, np.inf]
LENGTHS = [1e-6, 9.99e-4, 1e-3, 0.03, 1.0, 200.0]
mpmath.mp.dps = 50


def true_opacity(sigma: float, t: float) -> tuple:
    """Value, and derivatives with respect to σ and t."""
    s, l = mpmath.mpf(sigma), mpmath.mpf(t)
    if mpmath.isinf(s):
        return mpmath.mpf(1), mpmath.mpf(0), mpmath.mpf(0)
    through = mpmath.exp(-s * l)
    return -mpmath.expm1(-s * l), l * through, s * through


STEPS = 5000


def depths(total: float, seed: int) -> np.ndarray:
    """Random depths of very different sizes, `total` in sum."""
    tau = np.random.default_rng(seed).uniform(0, 1, STEPS) ** 8
    return (tau * total / tau.sum()).astype(np.float32)


def true_sums(tau: np.ndarray) -> np.ndarray:
    """Σ of the depths before each sample, then of all."""
    total, sums = mpmath.mpf(0), [0.0]
    for x in tau:
        total += mpmath.mpf(float(x))
        sums.append(float(total))
    return np.array(sums)


POINTS = np.array([-1e4, -104, -88, -20, -1, -1e-30, 0, 1e-30, 1, 20, 88, 104, 1e4], np.float32)


def true_softplus(x: np.ndarray) -> np.ndarray:
    return np.array([float(mpmath.log1p(mpmath.exp(mpmath.mpf(float(v))))) for v in x])
