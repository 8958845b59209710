"""Choose the settings of a march for a budget of seconds or an error: few samples a ray bias a picture, few rays make it noisy.

Notation
b, ν        a rung's bias, and its error of one ray a pixel by noise, over ν of the first rung                FLIP / FLIP
q           network queries of a ray, over the first rung's
e(n)        error of n rays a pixel, (b^p + ν^p / n^FALL)^(1/p): FLIP's power p (measure/flip); noise of independent rays
            would have a FALL of 1, and rays that cover a pixel evenly fall faster
c           what a ray costs, in queries, over the first rung's: RAY + q Q (1 + TAP (taps − 1) + EXACT x), with taps of the
            filter (one without), Q queries of the first rung's ray, x of 1 for exact coordinates, else 0

b, ν and q are geometric means of four scenes: grass, a field of it, details of a carpet and of fur, with density from the
network (benchmarks/ladder). The
last two biases are in proportion to the one before as those that are above the noise of their references: the field's and the
carpet's, and then the field's alone.
Of the user's scene two rays a pixel tell the seconds of a pass, its queries and its noise; its biases are taken to be as large
beside that noise as they were there, and where an error is promised SURE times as large: the four scenes' are from 0.4 to 2.0
times their mean.
"""

import time
from typing import Any, NamedTuple

import numpy as np

from mesoshell.measure.flip import POWER
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import FIRST, Goal, Sums, spread
from mesoshell.scene.picture import Passes, Prepared

#: What a ray costs apart from its queries, and what each further tap and exact coordinates add to a query, in queries.
RAY, TAP, EXACT = 15.0, 0.4, 0.3
#: FLIP of one ray a pixel against two, over ν; passes that a budget must hold; pixels, about, that a scene is probed with, and
#: that the chosen settings are compiled with.
PAIR, MIN_PASSES, PROBE, COMPILED = 0.79, 1.1, 16384, 2048
#: What the estimate of noise, which ends a picture, is over the noise itself, on the mean.
SURE, FALL, EXCESS = 1.7, 1.35, 1.17


class Rung(NamedTuple):
    """Settings, with their b, ν and q."""

    settings: dict[str, Any]
    bias: float
    noise: float
    queries: float

    def cost(self, queries: float) -> float:
        """c, where a ray of the first rung makes so many queries, over that rung's."""
        first, taps = RAY + queries, self.settings["anisotropy"] if self.settings.get("filtering", True) else 1
        exact = EXACT * (self.settings.get("coordinates") == "exact")
        return (RAY + self.queries * queries * (1 + TAP * (taps - 1) + exact)) / first


_FINE = {"light_samples": 12, "skip": 0.02, "weight_cut": 0.02, "base_samples": 16}
_NETWORK = {"density": "network"}
_EXACT = {"light_samples": 0, "early_stop": 0.0, "skip": 0.0, "weight_cut": 0.0, "base_samples": 32}
LADDER = (
    Rung(
        {**_NETWORK, "samples": 10, "early_stop": 0.05, "light_samples": 4, "footprint": 0.7, "anisotropy": 1},
        0.71,
        1.0,
        1.0,
    ),
    Rung({**_NETWORK, "samples": 14, "anisotropy": 1}, 0.59, 0.94, 1.30),
    Rung({**_NETWORK, "samples": 20, "height_filter": 0.2, "light_samples": 6, "anisotropy": 1}, 0.50, 0.85, 1.57),
    Rung({**_NETWORK, "samples": 28, "anisotropy": 2}, 0.48, 0.68, 2.1),
    Rung({**_NETWORK, "samples": 40, "footprint": 0.35, "anisotropy": 2, "coordinates": "exact"}, 0.32, 0.70, 2.7),
    Rung(
        {**_NETWORK, "samples": 64, "footprint": 0.25, "anisotropy": 2, "coordinates": "exact", **_FINE},
        0.22,
        0.64,
        4.5,
    ),
    Rung({**_NETWORK, "samples": 128, "filtering": False, "coordinates": "exact", **_FINE}, 0.15, 0.65, 7.0),
    Rung(
        {**_NETWORK, "samples": 256, "filtering": False, "spacing": "length", "coordinates": "exact", **_EXACT},
        0.089,
        0.46,
        47.0,
    ),
)


class Probe(NamedTuple):
    """What a probe tells of a scene, at the first rung: seconds a pass, FLIP of one ray a pixel, queries a ray."""

    seconds: float
    noise: float
    queries: float


class Choice(NamedTuple):
    """A rung's settings for a scene, its passes, the bias allowed for them, and seconds of probing and compiling."""

    settings: dict[str, object]
    passes: Passes
    bias: float
    seconds: float


def choose(prepared: Prepared, quality: Quality, goal: Goal) -> Choice:
    """What takes the least time to the goal's error if the budget allows it, else has the least error for the budget."""
    begin = time.perf_counter()
    seen = _probe(prepared.passes(quality.with_changes(**LADDER[0].settings)))
    budget = np.inf if goal.budget is None else goal.budget
    due = [_due(rung, seen, goal.error) for rung in LADDER]
    if min(due) < np.inf and min(due) <= budget:
        rung = LADDER[int(np.argmin(due))]
    elif budget < np.inf:
        rung = min(LADDER, key=lambda r: _error(r, seen, budget))
    else:
        rung = LADDER[-1]
    passes = prepared.passes(quality.with_changes(**rung.settings))
    passes.compile()
    passes.render(0, _some(passes, COMPILED), lambda share: None)
    return Choice(rung.settings, passes, SURE * seen.noise * rung.bias, time.perf_counter() - begin)


def _due(rung: Rung, seen: Probe, error: float | None) -> float:
    """Seconds to an error; infinite for one that the rung does not reach, or none."""
    if error is None or error <= SURE * seen.noise * rung.bias:
        return np.inf
    rest = (error / seen.noise) ** POWER - (SURE * rung.bias) ** POWER
    passes = ((EXCESS * rung.noise) ** POWER / max(rest, 1e-30)) ** (1 / FALL)
    return max(FIRST, passes) * rung.cost(seen.queries) * seen.seconds


def _error(rung: Rung, seen: Probe, budget: float) -> float:
    """e of a budget's passes, over ν; more than any if these are too few to be on time with."""
    passes = budget / (rung.cost(seen.queries) * seen.seconds)
    if passes < MIN_PASSES:
        return 1e6 / passes
    return (rung.bias**POWER + rung.noise**POWER / passes**FALL) ** (1 / POWER)


def _probe(passes: Passes) -> Probe:
    """From two rays a pixel; the first may wait for compiling."""
    pixels, count = _some(passes, PROBE), passes.shape[0] * passes.shape[1]
    sums, seconds = Sums(passes.shape), []
    for k in range(2):
        begin = time.perf_counter()
        sums.add(pixels, passes.render(k, pixels, lambda share: None))
        seconds.append(time.perf_counter() - begin)
    whole = count / passes.threads(count) / (len(pixels) / passes.threads(len(pixels)))
    record = passes.ended(np.zeros((*passes.shape, 4), np.float32), 2).record
    noise = float(sums.error().flat[pixels].mean()) / PAIR
    return Probe(seconds[1] * whole, max(noise, 1e-6), record["queries"] / max(record["rays"], 1))


def _some(passes: Passes, count: int) -> np.ndarray:
    return spread(np.arange(passes.shape[0] * passes.shape[1]), passes.shape, count)
