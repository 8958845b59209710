"""How well a surface material answers held-out queries.

Notation
α, ρ         opacity, and reflectance of rays that met something; with a hat, the material's answer
reflectance  Σ α |ρ̂ − ρ|² / Σ α |ρ|² over a patch, with the data's own noise in it
opacity      mean of |α̂ − α| over a patch
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from mesoshell.io.query_dataset import ALPHA, RGB
from mesoshell.measure.distribution import Estimate, mean_with_interval

#: Names of the scores.
QUERIES = ("reflectance: relative squared error", "opacity: mean error")


def score(
    answers: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    patches: tuple[Float[np.ndarray, "Q 16"], ...],
) -> dict[str, Estimate]:
    """Means over patches with their intervals. answers: of rows, α̂, the silhouette cosine and ρ̂."""
    each = []
    for rows in patches:
        alpha, _, rho = answers(rows)
        met = rows[:, ALPHA, None]
        wanted = rows[:, RGB] / np.maximum(met, 1e-3)
        apart = (met * (rho - wanted) ** 2).sum() / max(float((met * wanted**2).sum()), 1e-30)
        each.append((apart, np.abs(alpha - met[:, 0]).mean()))
    return dict(zip(QUERIES, mean_with_interval(np.array(each, np.float64)), strict=True))
