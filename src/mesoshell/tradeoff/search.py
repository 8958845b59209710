"""Which settings to measure next: one knob at a time, then what a model of the points so far expects the most of.

Notation
x           a point's knobs as zeros and ones: one for each step between neighbouring values, from `reference`'s to its own
t, b, ν     seconds a pass, bias and noise of a point. ln t and ln ν are modelled as sums over x, b^q as a sum of positive terms

The model proposes; what is shown is measured.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import nnls

from mesoshell.render.quality import PRESETS
from mesoshell.tradeoff.front import Entry, entries, front, gain
from mesoshell.tradeoff.knobs import VALUES, Settings, describe_changes, neighbours, settings_of
from mesoshell.tradeoff.points import Point, Q, combined_error

#: Pull of the model's effects towards none; changes that a proposal is away from the front.
RIDGE, STEPS = 0.02, 2


def singles(names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """`normal` and `draft`, each knob alone beside `normal`, near values first, and `reference`."""
    normal, draft, reference = (settings_of(PRESETS[name], names) for name in ("normal", "draft", "reference"))
    yield from (normal, draft)
    yield from neighbours(normal)
    yield reference
    yield from neighbours(normal, 2)


def around(names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Each knob alone beside `draft`, and beside `reference`."""
    for name in ("draft", "reference"):
        yield from neighbours(settings_of(PRESETS[name], names))


def propose(points: Sequence[Point]) -> dict[str, Any] | None:
    """Settings near the front, not measured yet, that the model expects to add most to it; None if none adds anything."""
    known, kept = {describe_changes(p.settings) for p in points}, front(entries(points))
    candidates: dict[str, dict[str, Any]] = {describe_changes(e.point.settings): dict(e.point.settings) for e in kept}
    for _ in range(STEPS):
        candidates |= {describe_changes(s): s for near in candidates.values() for s in neighbours(near)}
    fresh = [s for name, s in candidates.items() if name not in known]
    if not fresh:
        return None
    t, b, v = _model(points, fresh)
    counts = max((p.samples for p in points), key=len)
    worth = [_worth(*numbers, counts, kept) for numbers in zip(t, b, v, strict=True)]
    best = int(np.argmax(worth))
    return fresh[best] if worth[best] > 0 else None


def _worth(t: float, b: float, v: float, counts: Sequence[int], kept: Sequence[Entry]) -> float:
    return max(gain(n * t, float(combined_error(b, v, n)), kept) for n in counts)


def _model(points: Sequence[Point], fresh: Sequence[Settings]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t, b and ν of settings, as those of the points would have it."""
    columns = sorted({step for s in [*(p.settings for p in points), *fresh] for step in _steps(s)})

    def rows(settings: Sequence[Mapping[str, Any]]) -> np.ndarray:
        ones = [[float(c in steps) for c in columns] for steps in map(_steps, settings)]
        return np.concatenate([np.ones((len(settings), 1)), np.array(ones).reshape(len(settings), -1)], axis=1)

    x, wanted = rows([p.settings for p in points]), rows(fresh)
    pull = RIDGE * np.eye(x.shape[1])
    pull[0, 0] = 1e-9

    def summed(of: Sequence[float]) -> np.ndarray:
        y = np.log(np.maximum(of, 1e-6))
        return np.exp(wanted @ np.linalg.solve(x.T @ x + pull, x.T @ y))

    powers = np.array([p.bias**Q for p in points])
    effects, _ = nnls(np.concatenate([x, pull**0.5]), np.concatenate([powers, np.zeros(x.shape[1])]), maxiter=1000)
    return summed([p.seconds[1] for p in points]), (wanted @ effects) ** (1 / Q), summed([p.noise for p in points])


def _steps(settings: Mapping[str, Any]) -> set[tuple[str, int]]:
    """Steps from the reference's values to these: so a value that was not measured lies between its neighbours."""
    steps = set()
    for name, value in settings.items():
        here, there = (VALUES[name].index(x) for x in (value, getattr(PRESETS["reference"], name)))
        steps |= {(name, i) for i in (range(here, there) if here < there else range(there + 1, here + 1))}
    return steps
