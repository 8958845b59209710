"""FLIP: how different two pictures look when they are shown alternately in the same place (NumPy and SciPy only).

Andersson et al. 2020, *FLIP: a difference evaluator for alternating images*; sections and constants are the paper's.

symbol  meaning                                                                           shape, unit
a, b    pictures, linear Rec. 709 as a screen shows them: held within [0, 1]              (H, W, 3)
ppd     pixels a degree of sight; 67 is a 0.7 m wide screen of 3840 pixels seen from 0.7 m
YCxCz   a linear cousin of L*a*b*, in which the eye's contrast sensitivity filters
ΔE_c    difference of filtered colours, 0 to 1;    ΔE_f  of edges and points, 0 to 1
FLIP    ΔE_c^(1 − ΔE_f): 0 for equal pictures, 1 at most

The mean agrees with the authors' program to 1e-5 (test).
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.ndimage import correlate, correlate1d

PIXELS_A_DEGREE = 0.7 * (3840 / 0.7) * math.pi / 180
#: Sensitivities to contrast (section 4.1.1): pairs (a, b) of √(π/b)·a·exp(−π²x²/b), for Y, Cx and Cz.
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_WIDEST = 0.04
#: Exponents of colour and of feature differences; start and end of the compression of great differences; width of edges.
_Q_COLOUR, _Q_FEATURE, _P_C, _P_T, _WIDTH = 0.7, 0.5, 0.4, 0.95, 0.082


#: FLIP grows as the 0.7th power of a small difference of colours, and squares of independent differences add; so does this
#: power of FLIP: n samples of noise ν beside a bias b have (b^p + ν^p / n)^(1/p).
POWER = 2 / _Q_COLOUR


def flip(a: Float[np.ndarray, "H W 3"], b: Float[np.ndarray, "H W 3"], ppd: float = PIXELS_A_DEGREE) -> float:
    """Mean of FLIP over the pixels. Raises ValueError if the shapes differ."""
    return float(np.mean(flip_map(a, b, ppd)))


def flip_map(
    a: Float[np.ndarray, "H W 3"], b: Float[np.ndarray, "H W 3"], ppd: float = PIXELS_A_DEGREE
) -> Float[np.ndarray, "H W"]:
    """FLIP of each pixel. Raises ValueError if the shapes differ."""
    if a.shape != b.shape:
        raise ValueError(f"images of different shapes: {a.shape} and {b.shape}")
    x, y = (_opponent(np.clip(image.astype(np.float64), 0, 1)) for image in (a, b))
    return _colour_difference(x, y, ppd) ** (1 - _feature_difference(x[..., 0], y[..., 0], ppd))


def _primaries() -> Float[np.ndarray, "3 3"]:
    """XYZ of Rec. 709's red, green and blue, from their chromaticities and D65's."""
    xy = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]])
    xyz = np.column_stack([xy, 1 - xy.sum(axis=1)]) / xy[:, 1:]
    red_green_blue, white = xyz[:3].T, xyz[3]
    return red_green_blue * np.linalg.solve(red_green_blue, white)


_XYZ = _primaries()
_WHITE = _XYZ.sum(axis=1)


def _opponent(rgb: np.ndarray) -> np.ndarray:
    """YCxCz of linear RGB."""
    x, y, z = np.moveaxis(rgb @ (_XYZ / _WHITE[:, None]).T, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _rgb(opponent: np.ndarray) -> np.ndarray:
    """Its inverse, held within [0, 1]."""
    y = (opponent[..., 0] + 16) / 116
    xyz = np.stack([y + opponent[..., 1] / 500, y, y - opponent[..., 2] / 200], axis=-1) * _WHITE
    return np.clip(xyz @ np.linalg.inv(_XYZ).T, 0, 1)


def _lab(rgb: np.ndarray) -> np.ndarray:
    """L*a*b* of linear RGB with Hunt's adjustment: colour counts less where it is dark."""
    t, knee = rgb @ (_XYZ / _WHITE[:, None]).T, 6 / 29
    f = np.where(t > knee**3, np.cbrt(t), t / (3 * knee**2) + 4 / 29)
    light = 116 * f[..., 1] - 16
    red, yellow = 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])
    return np.stack([light, 0.01 * light * red, 0.01 * light * yellow], axis=-1)


def _apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """HyAB, a distance for large colour differences: lightness and chroma add up; to the power q_c."""
    d = a - b
    return (np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2])) ** _Q_COLOUR


def _colour_difference(x: np.ndarray, y: np.ndarray, ppd: float) -> np.ndarray:
    """ΔE_c of two pictures in YCxCz (section 4.1)."""
    a, b = (_lab(_rgb(_filtered(image, ppd))) for image in (x, y))
    green, blue = _lab(np.array([[[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]]))
    most = _apart(green, blue)[0]  # no two colours of a screen are farther apart
    d, knee = _apart(a, b), _P_C * most
    return np.where(d < knee, d * _P_T / knee, _P_T + (d - knee) / (most - knee) * (1 - _P_T))


def _filtered(image: np.ndarray, ppd: float) -> np.ndarray:
    """YCxCz as the eye resolves it at that distance."""
    r = math.ceil(3 * math.sqrt(_WIDEST / (2 * math.pi**2)) * ppd)
    squared = (np.arange(-r, r + 1) / ppd) ** 2
    squared = squared[:, None] + squared[None]
    channels = []
    for k, terms in enumerate(_SENSITIVITY):
        g = sum(a * math.sqrt(math.pi / b) * np.exp(-(math.pi**2) * squared / b) for a, b in terms)
        channels.append(correlate(image[..., k], g / np.sum(g), mode="nearest"))
    return np.stack(channels, axis=-1)


def _feature_difference(x: np.ndarray, y: np.ndarray, ppd: float) -> np.ndarray:
    """ΔE_f of two pictures' Y (section 4.2): edges by the first, points by the second derivative of a Gaussian."""
    deviation = 0.5 * _WIDTH * ppd
    at = np.arange(-math.ceil(3 * deviation), math.ceil(3 * deviation) + 1)
    g = np.exp(-(at**2) / (2 * deviation**2))
    edge, point = _balanced(-at * g), _balanced((at**2 / deviation**2 - 1) * g)

    def strength(image: np.ndarray, derivative: np.ndarray) -> np.ndarray:
        grey = (image + 16) / 116
        along = [
            correlate1d(correlate1d(grey, derivative, axis=i, mode="nearest"), g / g.sum(), axis=1 - i, mode="nearest")
            for i in (0, 1)
        ]
        return np.hypot(*along)

    edges, points = (np.abs(strength(x, k) - strength(y, k)) for k in (edge, point))
    return (np.maximum(edges, points) / math.sqrt(2)) ** _Q_FEATURE


def _balanced(taps: np.ndarray) -> np.ndarray:
    """Taps whose positive part sums to 1 and whose negative part to −1."""
    return np.where(taps > 0, taps / taps[taps > 0].sum(), -taps / taps[taps < 0].sum())
