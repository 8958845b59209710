"""How near a texture is to exemplars at any shift: is it a copy? (NumPy and SciPy only)

Notation
x            opacities of a window in K layers                                       (K, h, w)
e            those of an exemplar, a torus at least as large                         (K, V, U)
m            mean opacity of each layer, over all exemplars: subtracted from both
D(s)         |x − e_s|² / (|x|² + |e_s|²), e_s the window of e that begins at shift s, less m
             0 for a copy, about 1 for unrelated textures

D is computed at every shift, by FFT: |x − e_s|² = |x|² + |e_s|² − 2 x·e_s, and both sums are correlations with e.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Nearest(NamedTuple):
    """The least D, of which exemplar, and the shift (v, u) at which its window begins."""

    distance: float
    exemplar: int
    shift: tuple[int, int]


def layer_means(exemplars: Float[np.ndarray, "M K V U"]) -> Float[np.ndarray, "K 1 1"]:
    """m."""
    return exemplars.mean(axis=(0, 2, 3), dtype=np.float64)[:, None, None]


def nearest(
    x: Float[np.ndarray, "K h w"], exemplars: Float[np.ndarray, "M K V U"], mean: Float[np.ndarray, "K 1 1"]
) -> Nearest:
    """The nearest window of all exemplars."""
    closest = [_closest(x - mean, e - mean) for e in exemplars.astype(np.float64)]
    best = int(np.argmin([distance for distance, _ in closest]))
    return Nearest(closest[best][0], best, closest[best][1])


def among(exemplars: Float[np.ndarray, "M K V U"], side: tuple[int, int]) -> list[Nearest]:
    """For a window of each exemplar, of `side` (h, w): the nearest in all others. Raises ValueError for a single exemplar."""
    if len(exemplars) < 2:
        raise ValueError("needs two exemplars at least")
    mean = layer_means(exemplars)
    rows = []
    for i, e in enumerate(exemplars):
        others = np.delete(np.arange(len(exemplars)), i)
        best = nearest(e[:, : side[0], : side[1]].astype(np.float64), exemplars[others], mean)
        rows.append(best._replace(exemplar=int(others[best.exemplar])))
    return rows


def _closest(x: np.ndarray, e: np.ndarray) -> tuple[float, tuple[int, int]]:
    size = e.shape[1:]
    if x.shape[1] > size[0] or x.shape[2] > size[1]:
        raise ValueError(f"a window of {x.shape[1:]} is larger than an exemplar of {size}")
    ones = np.fft.rfft2(np.ones(x.shape[1:]), size)
    together = np.fft.irfft2((np.conj(np.fft.rfft2(x, size)) * np.fft.rfft2(e)).sum(axis=0), size)
    theirs = np.fft.irfft2(np.conj(ones) * np.fft.rfft2((e**2).sum(axis=0)), size)
    total = np.maximum((x**2).sum() + theirs, 1e-30)
    d = np.maximum(1 - 2 * together / total, 0)
    v, u = np.unravel_index(np.argmin(d), size)
    return float(d[v, u]), (int(v), int(u))
