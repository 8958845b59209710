"""Choose the settings of a march for a budget of seconds or an error: few samples a ray bias a picture, few rays make it noisy.

Notation
b, c        a rung's bias and its cost, relative to the first rung's                                          FLIP, 1
ν           error of one ray a pixel, that of n is ν / √n                                                    FLIP
s           a scene's errors relative to those of the table, by its noise

b, c and ν are of `spot.obj` with grass that fills half of the picture (benchmarks/ladder). A rung that takes c t seconds a pass
reaches s √(b² + ν² / n) after n of them: bias and noise are independent. Of a scene only t and s are measured, on blocks of its
pixels.
"""

import time
from typing import NamedTuple

import numpy as np

from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import FIRST, Goal, Sums, spread
from mesoshell.scene.picture import Passes, Prepared

#: ν; FLIP of one ray a pixel against two, of the first rung; passes that a budget must hold; and pixels, about, that a scene is
#: probed with, and that the chosen settings are compiled with.
NOISE, PAIR, FEWEST, PROBE, COMPILED = 0.022, 0.0299, 1.1, 16384, 2048


class Rung(NamedTuple):
    """Settings, with their b and c."""

    settings: dict[str, object]
    bias: float
    cost: float


#: What `normal` had when the ladder was measured, and has no more.
_THEN = {"early_stop": 0.01, "light_samples": 6, "anisotropy": 1, "environment_samples": 4}
_FINE = {"light_samples": 12, "early_stop": 0.005, "skip": 0.02, "weight_cut": 0.02, "base_samples": 16}
_EXACT = {"light_samples": 0, "early_stop": 0.0, "skip": 0.0, "weight_cut": 0.0, "base_samples": 32}
LADDER = (
    Rung({**_THEN, "samples": 10, "height_filter": 0.3, "early_stop": 0.05, "base_samples": 4}, 0.0269, 1.0),
    Rung({**_THEN, "samples": 14, "height_filter": 0.3, "early_stop": 0.02}, 0.0219, 1.1),
    Rung({**_THEN, "samples": 20, "anisotropy": 4}, 0.0154, 1.6),
    Rung({**_THEN, "samples": 28, "anisotropy": 4}, 0.0127, 1.9),
    Rung({**_THEN, "samples": 48, "anisotropy": 4, **_FINE}, 0.0092, 2.6),
    Rung({**_THEN, "samples": 96, "anisotropy": 8, **_FINE, "light_samples": 0}, 0.0048, 8.0),
    Rung({**_THEN, "samples": 256, "anisotropy": 16, "coordinates": "exact", **_EXACT}, 0.0014, 37.4),
)


class Choice(NamedTuple):
    """A rung's settings for a scene, its passes, the bias expected of them, and seconds of probing and compiling."""

    settings: dict[str, object]
    passes: Passes
    bias: float
    seconds: float


def choose(prepared: Prepared, quality: Quality, goal: Goal) -> Choice:
    """What takes the least time to the goal's error if the budget allows it, else has the least error for the budget."""
    begin = time.perf_counter()
    t, s = _probe(prepared.passes(quality.with_changes(**LADDER[0].settings)))
    budget = np.inf if goal.budget is None else goal.budget
    due = [_due(rung, t, s, goal.error) for rung in LADDER]
    if min(due) < np.inf and min(due) <= budget:
        rung = LADDER[int(np.argmin(due))]
    elif budget < np.inf:
        rung = min(LADDER, key=lambda r: _error(r, budget / (r.cost * t)))
    else:
        rung = LADDER[-1]
    passes = prepared.passes(quality.with_changes(**rung.settings))
    passes.render(0, _some(passes, COMPILED), lambda share: None)
    return Choice(rung.settings, passes, s * rung.bias, time.perf_counter() - begin)


def _due(rung: Rung, t: float, s: float, error: float | None) -> float:
    """Seconds to an error; infinite for one that the rung does not reach, or none."""
    if error is None or error <= s * rung.bias:
        return np.inf
    return max(FIRST, (s * NOISE) ** 2 / (error**2 - (s * rung.bias) ** 2)) * rung.cost * t


def _error(rung: Rung, passes: float) -> float:
    """Of a scene with s = 1, after so many passes; above 1 if these are too few to be on time with."""
    return np.hypot(rung.bias, NOISE / passes**0.5) if passes >= FEWEST else 1 + 1 / passes


def _probe(passes: Passes) -> tuple[float, float]:
    """t and s, from two rays a pixel; the first may wait for compiling."""
    pixels, count = _some(passes, PROBE), passes.shape[0] * passes.shape[1]
    sums, seconds = Sums(passes.shape), []
    for k in range(2):
        begin = time.perf_counter()
        sums.add(pixels, passes.render(k, pixels, lambda share: None))
        seconds.append(time.perf_counter() - begin)
    whole = count / passes.threads(count) / (len(pixels) / passes.threads(len(pixels)))
    return seconds[1] * whole, float(sums.error().flat[pixels].mean()) / PAIR


def _some(passes: Passes, count: int) -> np.ndarray:
    return spread(np.arange(passes.shape[0] * passes.shape[1]), passes.shape, count)
