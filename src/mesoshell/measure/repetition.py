"""Does a texture repeat itself, or drift? (NumPy and SciPy only)

Notation
F           texture, (V, U, C)
lag         displacement between two places, texels
A(lag)      Σ_c cov(F_c(x), F_c(x + lag)) / Σ_c var F_c, over all x with both places in the texture
"""

import numpy as np
from jaxtyping import Float
from scipy.signal import fftconvolve


def autocorrelation(f: Float[np.ndarray, "V U C"]) -> Float[np.ndarray, "v u"]:
    """A at lags from −(V − 1) to V − 1 along v and from 0 to U − 1 along u; row V − 1, column 0 is lag 0. Means are the whole
    texture's."""
    x = f.astype(np.float64) - f.mean(axis=(0, 1), dtype=np.float64)
    total = np.zeros((2 * f.shape[0] - 1, 2 * f.shape[1] - 1))
    for c in range(f.shape[2]):
        total += fftconvolve(x[..., c], x[::-1, ::-1, c])
    ones = np.outer(*(n - np.abs(np.arange(1 - n, n)) for n in f.shape[:2]))
    covariance = (total / ones)[:, f.shape[1] - 1 :]
    return covariance / covariance[f.shape[0] - 1, 0]


def largest_repeat(f: Float[np.ndarray, "V U C"], least: int) -> tuple[float, tuple[int, int]]:
    """The largest A at lags of at least `least` texels, of those at which half of each side overlaps; and its lag (v, u)."""
    a = autocorrelation(f)
    v, u = np.arange(1 - f.shape[0], f.shape[0])[:, None], np.arange(f.shape[1])[None]
    counts = (np.hypot(v, u) >= least) & (np.abs(v) <= f.shape[0] // 2) & (u <= f.shape[1] // 2)
    i, j = np.unravel_index(np.argmax(np.where(counts, a, -np.inf)), a.shape)
    return float(a[i, j]), (int(i) - f.shape[0] + 1, int(j))
