"""The direction of a pile at places: of strokes in a picture, or of strands in a volume (NumPy and SciPy only).

Notation
f            a picture (V, U), or a volume (K, V, U) of opacities whose layers k go from the base up
S            structure tensor: Gaussian means of products of f's derivatives; along a stroke f changes least
angle        from u toward v, radians
coherence    ((λ₁ − λ₂) / (λ₁ + λ₂))² of a picture's S: 1 for strokes all alike, 0 without a direction
period       an angle is the same after this much: π of strokes, 2π of a lean

A picture's strokes have no sign: grass combed to the left looks as if combed to the right, so its angles are modulo π. A volume
has one, since strands go up: a lean points from the root toward the tip. A lean of 0 has no angle: the smaller the lean, the
less its angle means.
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

#: Deviation, in pixels, of the Gaussian that f is blurred by before it is differentiated.
BLUR = 1.0


def strokes(
    f: Float[np.ndarray, "V U"], places: tuple[int, int]
) -> tuple[Float[np.ndarray, "P Q"], Float[np.ndarray, "P Q"]]:
    """Angle modulo π and coherence at P × Q places: means over the middle halves of equal rectangles."""
    gv, gu = (_derivative(f, axis) for axis in (0, 1))
    vv, uu, uv = (_at_places(x, places) for x in (gv * gv, gu * gu, gu * gv))
    along = 0.5 * np.arctan2(2 * uv, uu - vv) + math.pi / 2
    spread, total = np.hypot(uu - vv, 2 * uv), uu + vv
    return along % math.pi, np.divide(spread, total, out=np.zeros_like(total), where=total > 0) ** 2


def leans(
    f: Float[np.ndarray, "K V U"], spacing: tuple[float, float], places: tuple[int, int]
) -> tuple[Float[np.ndarray, "P Q"], Float[np.ndarray, "P Q"]]:
    """Angle modulo 2π, and size as run over rise, of strands at P × Q places. spacing: between layers and between texels, in
    one unit of length."""
    g = [_derivative(f, axis) / spacing[min(axis, 1)] for axis in range(3)]
    tensor = np.array([[_at_places((a * b).mean(axis=0), places) for a in g] for b in g])
    axis = np.linalg.eigh(np.moveaxis(tensor, (0, 1), (-2, -1)))[1][..., 0]  # (k, v, u) that changes least
    axis = axis * np.where(axis[..., :1] < 0, -1, 1)
    run, rise = np.hypot(axis[..., 1], axis[..., 2]), axis[..., 0]
    size = np.divide(run, rise, out=np.full_like(run, np.inf), where=rise > 0)
    return np.arctan2(axis[..., 1], axis[..., 2]) % (2 * math.pi), size


def mean_error(measured: Float[np.ndarray, "*n"], wanted: Float[np.ndarray, "*n"], period: float) -> float:
    """Mean of |measured − wanted|, each at most half a period. Chance is a quarter of a period."""
    off = (measured - wanted + period / 2) % period - period / 2
    return float(np.abs(off).mean())


def _derivative(f: np.ndarray, axis: int) -> np.ndarray:
    """Along an axis, of f blurred by a Gaussian of BLUR."""
    x = f.astype(np.float64)
    for i in range(f.ndim):
        x = gaussian_filter1d(x, BLUR, axis=i, order=int(i == axis))
    return x


def _at_places(x: Float[np.ndarray, "V U"], places: tuple[int, int]) -> Float[np.ndarray, "P Q"]:
    """Means over the middle halves of P × Q rectangles."""

    def middles(size: int, count: int) -> list[slice]:
        side = size / count
        return [slice(round((i + 0.25) * side), max(round((i + 0.75) * side), 1)) for i in range(count)]

    rows, columns = (middles(n, p) for n, p in zip(x.shape, places, strict=True))
    return np.array([[x[r, c].mean() for c in columns] for r in rows])
