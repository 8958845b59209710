"""Sliced Wasserstein distance between patches of two sets of pictures: a measure without a network (NumPy and SciPy).

Notation
level        of a Laplacian pyramid: 0 is the finest; the coarsest is no difference but the blurred rest   Burt and Adelson 1983
descriptor   7 × 7 pixels of a level in 3 channels, at PATCHES random places of a picture                 147 numbers
X, Y         descriptors of N pictures each, less the mean and over the deviation of X's channels
SWD          mean over random directions of the Wasserstein-1 distance between X and Y projected on them

After Karras et al. 2018, section 5, who normalise each set by itself. Here both are by the first, the real one, so that
colour and contrast count. The unit is then a standard deviation of the level. The fewer pictures, the greater the distance:
compare numbers of equal N, and with that of renders against other renders.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import convolve1d

PATCHES, SIDE, DIRECTIONS = 32, 7, 128
#: Sides in pixels below which there is no further level.
COARSEST = 16
_TAPS = np.array([1, 4, 6, 4, 1], np.float32) / 16


def pyramid(x: Float[np.ndarray, "N H W C"]) -> list[Float[np.ndarray, "N _h _w C"]]:
    """Differences of each level from the next, enlarged, and the coarsest level, of at least COARSEST pixels a side."""
    levels = []
    while min(x.shape[1:3]) >= 2 * COARSEST and x.shape[1] % 2 == x.shape[2] % 2 == 0:
        half = _blurred(x)[:, ::2, ::2]
        wide = np.zeros_like(x)
        wide[:, ::2, ::2] = 4 * half
        levels.append(x - _blurred(wide))
        x = half
    return [*levels, x]


def descriptors(pictures: Float[np.ndarray, "N H W C"], seed: int = 0) -> list[Float[np.ndarray, "N D"]]:
    """Descriptors of each level, finest first; a row a picture."""
    rng = np.random.default_rng(seed)
    rows = []
    for level in pyramid(pictures.astype(np.float32)):
        n, height, width, channels = level.shape
        windows = np.lib.stride_tricks.sliding_window_view(level, (SIDE, SIDE), axis=(1, 2))
        v, u = (rng.integers(0, side - SIDE + 1, (n, PATCHES)) for side in (height, width))
        rows.append(windows[np.arange(n)[:, None], v, u].reshape(n, PATCHES * channels * SIDE**2))
    return rows


def swd(x: Float[np.ndarray, "N D"], y: Float[np.ndarray, "M D"]) -> float:
    """SWD of one level's descriptors; x is the real set. Raises ValueError unless both have the same size."""
    if x.shape != y.shape:
        raise ValueError(f"needs as many pictures of each, not {len(x)} and {len(y)}")
    size = SIDE**2
    a, b = (s.reshape(len(x), PATCHES, s.shape[1] // PATCHES // size, size) for s in (x, y))
    mean = a.mean(axis=(0, 1, 3), keepdims=True)
    deviation = np.maximum(a.std(axis=(0, 1, 3), keepdims=True), 1e-12)
    rows = [((s - mean) / deviation).reshape(len(x) * PATCHES, s.shape[2] * size) for s in (a, b)]
    directions = np.random.default_rng(0).normal(size=(rows[0].shape[1], DIRECTIONS)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=0)
    p, q = (np.sort(row @ directions, axis=0) for row in rows)
    return float(np.abs(p - q).mean())


def _blurred(x: np.ndarray) -> np.ndarray:
    """Beyond an edge lies what is within, without the edge itself: a picture with zeros between keeps its pattern."""
    return convolve1d(convolve1d(x, _TAPS, axis=1, mode="mirror"), _TAPS, axis=2, mode="mirror")
