"""A blind test: which of these pictures are real? (NumPy and SciPy only)

Notation
sheet        real and made pictures in equal numbers, shuffled, read row by row
answer       True where a picture is real                                     (2n,)
mark         what a judge says of each: r for real, m for made

The interval is Clopper and Pearson's, 95%; `chance` is the probability of as many right by guessing, or more.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.stats import binomtest

from mesoshell.io.sheet import over_grey, tile_pictures

#: Pictures a row of a sheet; least side of a picture on it, pixels.
COLUMNS, MIN_SIDE = 8, 128


class Judged(NamedTuple):
    """right: how many of count; share, with its interval; chance."""

    right: int
    count: int
    share: float
    low: float
    high: float
    chance: float


class Sheet(NamedTuple):
    """pictures in their order on the sheet; answer; pose: which of the n poses each shows."""

    pictures: Float[np.ndarray, "_m H W C"]
    answer: Bool[np.ndarray, "_m"]
    pose: Integer[np.ndarray, "_m"]


def shuffle_pictures(real: Float[np.ndarray, "n H W C"], made: Float[np.ndarray, "n H W C"], seed: int) -> Sheet:
    """Real and made pictures in a random order, given by the seed."""
    order = np.random.default_rng(seed).permutation(len(real) + len(made))
    return Sheet(np.concatenate([real, made])[order], order < len(real), order % len(real))


def draw_sheet(sheet: Sheet) -> Float[np.ndarray, "_h _w 3"]:
    """The sheet as one image; pictures are enlarged by a whole factor."""
    factor = -(-MIN_SIDE // sheet.pictures.shape[1])
    return tile_pictures(over_grey(sheet.pictures).repeat(factor, axis=1).repeat(factor, axis=2), COLUMNS)


def letters(answer: Bool[np.ndarray, "_m"]) -> str:
    """The marks of a judge who is always right."""
    return "".join("r" if real else "m" for real in answer)


def marks(text: str) -> Bool[np.ndarray, "_m"]:
    """Marks from letters r and m in the sheet's order, without white space and commas. Raises ValueError for others."""
    given = "".join(text.split()).replace(",", "").lower()
    unknown = sorted(set(given) - set("rm"))
    if unknown:
        raise ValueError(f"has {unknown[0]!r}; marks are r (real) and m (made)")
    return np.array([letter == "r" for letter in given], bool)


def score_judge(answer: Bool[np.ndarray, "m"], given: Bool[np.ndarray, "m"]) -> Judged:
    """How often a judge was right."""
    right, count = int((answer == given).sum()), len(answer)
    test = binomtest(right, count, 0.5, alternative="greater")
    interval = binomtest(right, count, 0.5).proportion_ci(0.95, "exact")
    return Judged(right, count, right / count, interval.low, interval.high, float(test.pvalue))
