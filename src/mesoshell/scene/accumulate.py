"""Accumulate a picture pass by pass, until a budget of seconds, an error or a number of samples is reached.

Notation
n, m        samples of a pixel, and the first of them: 1, 3, 5, 9, 17, ..., a quarter to three fifths of n
M, E        its mean over all passes, and over the first m
e           (m / (n − m))^(1/p) FLIP(E, M), of FLIP's power p (measure/flip), estimates FLIP(M, expectation): of independent
            passes, E − M has (n − m) / m times the variance of M's error. Passes of rays that cover a pixel evenly have a
            smaller error than that; an odd number of them lies evenly about its centre.

The estimate knows no bias, which all passes have in common. It is of the tone-mapped picture over a grey backdrop, on which
silhouettes count too. Blocks of pixels whose own estimate, and that of their neighbours, is within the error are left alone.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter

from mesoshell.errors import Argument, InputError
from mesoshell.interrupt import StopRequest
from mesoshell.measure.flip import POWER, flip_map
from mesoshell.render.sequence import GOLDEN
from mesoshell.scene.picture import Passes, Progress, Rendered

#: Radiance behind a transparent picture; pixels of a block's side; passes before the first estimate, and growth of their number
#: up to the next; most samples a pixel where no number is given; least share of a pass's pixels that is worth its while.
BACKDROP, BLOCK, FIRST, GROWTH, MAX_SAMPLES, MIN_SHARE = 0.2, 16, 3, 1.3, 4096, 0.1
#: Share of a pass's time that a pass of next to no pixels saves: 0.9 of 256 x 256 pixels, 0.5 of 48 x 48.
SAVED = 0.7


@dataclass(frozen=True)
class Goal:
    """When a picture ends: at the first that is met. budget: seconds of the render loop; error: mean FLIP; max_samples: of a
    pixel. Raises InputError for a number that none can be."""

    budget: float | None = None
    error: float | None = None
    max_samples: int = MAX_SAMPLES

    def __post_init__(self) -> None:
        for name, most in (("budget", np.inf), ("error", 1.0)):
            value = getattr(self, name)
            if value is not None and not 0 < value < most:
                raise InputError(
                    Argument(name), f"must be above 0 and {'finite' if most > 1 else 'below 1'}, not {value}"
                )
        if self.max_samples < 1:
            raise InputError(Argument("max_samples"), f"must be at least 1, not {self.max_samples}")

    def less(self, bias: float) -> "Goal":
        """The goal of the noise alone, which is independent of a bias; half of the error if the bias is most of it, or more."""
        if self.error is None:
            return self
        rest = max(self.error**POWER - bias**POWER, (self.error / 2) ** POWER)
        return replace(self, error=rest ** (1 / POWER))


def goal_of(
    budget: float | None, error: float | None, max_samples: int | None, changes: Mapping[str, Any]
) -> Goal | None:
    """The goal of a picture; None if none is given. changes: of its quality's fields, which must not count samples too."""
    if budget is error is max_samples is None:
        return None
    for name in ("pixel_samples", "spp"):
        if name in changes:
            raise InputError(Argument(name), "cannot be combined with a goal, which sets it: give `max_samples`")
    return Goal(budget, error, MAX_SAMPLES if max_samples is None else max_samples)


@dataclass
class _Clock:
    """Seconds of passes, with the pixels of each, and of estimates. Unless all is compiled (warm) the first pass counts as the
    second would with as many pixels."""

    warm: bool
    passes: list[float] = field(default_factory=list)
    pixels: list[int] = field(default_factory=list)
    estimates: float = 0.0

    def add(self, since: float, pixels: int) -> None:
        self.passes.append(time.perf_counter() - since)
        self.pixels.append(pixels)

    @property
    def warming(self) -> float:
        if self.warm or len(self.passes) < 2:
            return 0.0
        return max(0.0, self.passes[0] - self.passes[1] / self._share(self.pixels[1]))

    @property
    def spent(self) -> float:
        return sum(self.passes) - self.warming + self.estimates

    def expected(self, pixels: int) -> float:
        """Seconds of a pass of so many pixels."""
        return self._whole * self._share(pixels)

    def affordable(self, seconds: float) -> float:
        """Pixels of a pass of so many seconds."""
        return self.pixels[0] * (1 - (1 - seconds / self._whole) / SAVED)

    @property
    def _whole(self) -> float:
        """Seconds of a pass of all pixels, as the first one is, by the last one."""
        return self.passes[-1] / self._share(self.pixels[-1])

    def _share(self, pixels: int) -> float:
        return 1 - SAVED + SAVED * pixels / self.pixels[0]


class Sums:
    """Sums of all passes and of the first m, for each pixel; a pixel without a pass is empty. The sum that belongs to the next
    value of m is kept beside them until m rises to it."""

    def __init__(self, shape: tuple[int, int]):
        self.shape = shape
        self.total, self.passes = np.zeros((shape[0] * shape[1], 4)), np.zeros(shape[0] * shape[1], int)
        self._early, self._late = (self.total.copy(), self.passes.copy()), (self.total.copy(), self.passes.copy())

    def add(self, pixels: Int[np.ndarray, "P"], rgba: Float[np.ndarray, "P 4"]) -> None:
        self.total[pixels] += rgba
        self.passes[pixels] += 1
        n = self.passes[pixels]
        reached = (n - 1) & (n - 2) == 0  # 1, 2, 3, 5, 9, ...
        now = self.total, self.passes
        for source, target, some in ((self._late, self._early, n != 3), (now, self._late, n != 2)):
            at = pixels[reached & some]
            for a, b in zip(source, target, strict=True):
                b[at] = a[at]

    def mean(self) -> Float[np.ndarray, "H W 4"]:
        return (self.total / np.maximum(self.passes, 1)[:, None]).reshape(*self.shape, 4)

    def error(self) -> Float[np.ndarray, "H W"]:
        """e; of two passes at least."""
        early, m = self._early
        known = (early / np.maximum(m, 1)[:, None]).reshape(*self.shape, 4)
        rest = (m / np.maximum(self.passes - m, 1)).reshape(self.shape) ** (1 / POWER)
        return rest * flip_map(over_backdrop(known), over_backdrop(self.mean()))


def accumulate(passes: Passes, goal: Goal, progress: Progress, warm: bool = False) -> Rendered:
    """The picture that passes come to. SIGINT or SIGTERM ends it with the passes so far. warm: all is compiled."""
    sums, clock, met = Sums(passes.shape), _Clock(warm), ""
    active, due = np.arange(len(sums.passes)), FIRST
    own = threading.current_thread()
    with StopRequest() as stop:

        def moved(share: float) -> None:
            if stop.requested:
                raise _Stopped
            if threading.current_thread() is own:  # tiles call this from threads of theirs
                progress(_share(goal, clock, share))

        while not met:
            pixels = _affordable(goal, clock, active, passes) if len(clock.passes) >= 2 - warm else active
            if not len(pixels):
                met = "budget"
                break
            try:
                begin = time.perf_counter()
                sums.add(pixels, passes.render(len(clock.passes), pixels, moved))
                clock.add(begin, len(pixels))
            except _Stopped:
                if not clock.passes:
                    raise KeyboardInterrupt from None
                met = "interrupt"
                break
            if len(clock.passes) >= goal.max_samples:
                met = "max_samples"
            if goal.error is not None and len(clock.passes) >= due:
                begin = time.perf_counter()
                error = sums.error()
                if error.mean() <= goal.error:
                    met = "error"
                elif passes.chosen:
                    active = np.flatnonzero(_unfinished(error, goal.error))
                clock.estimates += time.perf_counter() - begin
                due = len(clock.passes) + max(2, 2 * round((GROWTH - 1) * len(clock.passes) / 2))
    return _ended(passes, goal, sums, clock, met)


class _Stopped(Exception):
    pass


def _affordable(goal: Goal, clock: _Clock, active: Int[np.ndarray, "P"], passes: Passes) -> Int[np.ndarray, "_"]:
    """Pixels of the next pass that the budget leaves time for: all, or blocks of them, spread over the picture; none if they
    are few. Where pixels cannot be left out, all if more than half of them would be rendered in time."""
    if goal.budget is None:
        return active
    left, count = goal.budget - clock.spent, len(active)
    if left >= (1.0 if passes.chosen else 0.5) * clock.expected(count):
        return active
    share = clock.affordable(left) / count
    if share < MIN_SHARE or not passes.chosen:
        return active[:0]
    return spread(active, passes.shape, int(share * len(active)))


def spread(pixels: Int[np.ndarray, "P"], shape: tuple[int, int], count: int) -> Int[np.ndarray, "_"]:
    """About so many of the pixels, in blocks spread over the picture; all if there are no more."""
    y, x = np.divmod(pixels, shape[1])
    _, block = np.unique(y // BLOCK * shape[1] + x // BLOCK, return_inverse=True)
    return pixels[(block * GOLDEN) % 1 < count / len(pixels)]


def _ended(passes: Passes, goal: Goal, sums: Sums, clock: _Clock, met: str) -> Rendered:
    """What was promised and reached, beside what the engine gives."""
    samples = sums.passes
    rendered = passes.ended(sums.mean().astype(np.float32), round(float(samples.mean())))
    reached: dict[str, Any] = {
        "met": met,
        "promised": {"budget": goal.budget, "error": goal.error, "max_samples": goal.max_samples},
        "seconds": clock.spent,
        "noise": float(sums.error().mean()) if sums.passes.min() > 1 else None,
        "samples": {"least": int(samples.min()), "mean": float(samples.mean()), "most": int(samples.max())},
    }
    seconds = {**rendered.seconds, "warming": clock.warming, "loop": clock.spent, "estimates": clock.estimates}
    return rendered._replace(record={**rendered.record, "goal": reached}, seconds=seconds)


def _share(goal: Goal, clock: _Clock, share: float) -> float:
    """Of the work done, for a bar: of the goal that is nearest."""
    done = [(len(clock.passes) + share) / goal.max_samples]
    if goal.budget is not None and clock.passes:
        done.append((clock.spent + share * clock.passes[-1]) / goal.budget)
    return min(1.0, max(done))


def _unfinished(error: Float[np.ndarray, "H W"], most: float) -> Bool[np.ndarray, "P"]:
    """Pixels of blocks that are above the error, or have such a neighbour."""
    height, width = error.shape
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    sums = np.add.reduceat(np.add.reduceat(error, rows, axis=0), columns, axis=1)
    counts = np.diff([*rows, height])[:, None] * np.diff([*columns, width])
    above = maximum_filter(sums / counts, size=3, mode="nearest") > most
    return np.repeat(np.repeat(above, BLOCK, axis=0)[:height], BLOCK, axis=1)[:, :width].ravel()


def over_backdrop(rgba: Float[np.ndarray, "*K H W 4"]) -> Float[np.ndarray, "*K H W 3"]:
    """What FLIP compares."""
    return rgba[..., :3] + (1 - rgba[..., 3:]) * BACKDROP
