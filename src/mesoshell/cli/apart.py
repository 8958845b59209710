"""How different a surface material looks from what it was taught by, by footprint.

Alphabet
radius       standard deviation of a pixel's footprint, periods; pixels are two of them apart
picture      SIDE² pixels of a cylinder of any curvature that was trained, from one direction, under one light: both drawn anew
             for each. It is as bright as a screen can show it, before BEHIND
error        FLIP of the picture by the material against that by its teacher: 0 is the same, 1 the most
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from mesoshell.io.patches import COLUMNS
from mesoshell.measure.flip import flip
from mesoshell.mesostructure.render import FINEST, LEAST, Answers, rows_of
from mesoshell.mesostructure.tile import Placing

SIDE, PICTURES, BEHIND = 32, 12, 0.25
_ALPHA, _RGB = COLUMNS.index("alpha"), slice(COLUMNS.index("r"), COLUMNS.index("b") + 1)

#: Of rows of queries: α, the silhouette cosine and ρ.
Painter = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def errors_by_radius(
    answers: Answers, painter: Painter, curvature: tuple[float, float], widest: float
) -> tuple[tuple[float, float], ...]:
    """(radius, error), octaves up to the widest that was trained: the mean over pictures and 1.96 standard errors."""
    found = []
    for k, radius in enumerate(radii(widest)):
        each = [_error(answers, painter, curvature, radius, np.random.default_rng([k, i])) for i in range(PICTURES)]
        found.append((radius, float(np.mean(each) + 1.96 * np.std(each, ddof=1) / PICTURES**0.5)))
    return tuple(found)


def radii(widest: float) -> tuple[float, ...]:
    """Octaves from the finest radius, or just above it, to the widest."""
    return tuple(float(r) for r in widest / 2.0 ** np.arange(int(np.log2(widest / FINEST)), -1, -1))


def _error(
    answers: Answers, painter: Painter, curvature: tuple[float, float], radius: float, random: np.random.Generator
) -> float:
    placing = Placing(random.uniform(*curvature), random.uniform(0, 2 * np.pi), tuple(random.random(2)))
    cosine, up, around = random.uniform(LEAST, 1), random.random(), random.uniform(0, 2 * np.pi)
    level = np.sqrt(1 - up**2)
    i = (np.arange(SIDE) + 0.5 - SIDE / 2) * 2 * radius
    n = SIDE**2
    asked = {
        "place": np.stack(np.meshgrid(i, i), axis=-1).reshape(n, 2),
        "radius": np.full(n, radius),
        "toward": np.tile([np.sqrt(1 - cosine**2), 0, cosine], (n, 1)),
        "light": np.tile([level * np.cos(around), level * np.sin(around), up], (n, 1)),
    }
    rows = rows_of(placing, asked, answers(placing, asked, 0)[0], 0)
    alpha, _, rho = painter(rows)
    bright = max(float(np.quantile(rows[:, _RGB], 0.99)), 1e-6)
    return flip(_shown(rows[:, _ALPHA], rows[:, _RGB] / bright), _shown(alpha, alpha[:, None] * rho / bright))


def _shown(alpha: Float[np.ndarray, "N"], rgb: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "S S 3"]:
    return (rgb + (1 - alpha)[:, None] * BEHIND).reshape(SIDE, SIDE, 3)
