"""The picture that all others are measured against.

Notation
R           the expected picture of the preset `reference`, whose rays see the texture unfiltered. R is the same with any
            values of knobs that only add noise, which a path tracer's r_k have from `normal`
r_k         passes of it, of a ray a pixel
T           R's estimate: the mean of r_k over other k than those of points, an even number. A march's rays lie evenly about the
            pixel's centre from an odd k on, paths from a multiple of a power of two
noise       FLIP of T of the first half of passes against T, which estimates that of T against R. If it ends early, of a number
            of passes near the half, its difference as large as that of the half would be
variance    relative squared error of T, which the two halves estimate too
"""

import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.measure.flip import flip
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.picture import Passes, Progress

#: First of T's passes of paths; the fewest and most of T's.
AT, MIN_PASSES, MAX_PASSES = 2**20, 16, 1024
_DARK = 0.01


def _after(count: int) -> int:
    """Of how many passes T is looked at next."""
    return 2 * math.ceil(count * 5 / 8)


def _looked_at() -> Iterator[int]:
    count = MIN_PASSES
    while count < MAX_PASSES:
        yield count
        count = _after(count)
    yield count


class Reference(NamedTuple):
    """T; r_0; noise and variance; passes that T is of; whether passes of other settings see the same rays."""

    image: Float[np.ndarray, "H W 4"]
    first: Float[np.ndarray, "H W 4"]
    noise: float
    variance: float
    passes: int
    same_rays: bool


def render_reference(
    exact: Passes,
    same_rays: bool,
    seconds: float,
    aim: float,
    progress: Progress,
    stopped: Callable[[], bool] = lambda: False,
) -> Reference:
    """T within about so many seconds; sooner if its noise is at most `aim`, or if `stopped`."""
    begin, pixels = time.perf_counter(), np.arange(exact.shape[0] * exact.shape[1])

    def one(k: int) -> np.ndarray:
        progress(min(1.0, (time.perf_counter() - begin) / seconds))
        return exact.render(k, pixels, lambda share: None).reshape(*exact.shape, 4)

    first, due, count, halves = one(0), MIN_PASSES, 0, {n // 2 for n in _looked_at()}
    total, sums = (
        np.zeros_like(first, np.float64),
        {},
    )  # of so many passes, which may be the first half of those to come
    while True:
        for _ in range(2):
            total += one(AT + same_rays + count)
            count += 1
            if count in halves:
                sums[count] = total.copy()
        late = count >= MIN_PASSES and (time.perf_counter() - begin > seconds or stopped())
        if count < due and not late:
            continue
        half = min(sums, key=lambda n: abs(n - count / 2))
        true = over_backdrop(total / count)
        apart = (over_backdrop(sums[half] / half) - true) * (half / (count - half)) ** 0.5
        noise, due = flip(true + apart, true), _after(count)
        if late or noise <= aim or count >= MAX_PASSES:
            return Reference(total / count, first, noise, relative(apart, true), count, same_rays)
        sums = {n: x for n, x in sums.items() if n >= half}


def relative(difference: np.ndarray, true: np.ndarray) -> float:
    """Relative squared error: the mean of (I − T)²/(T² + 0.01) over pixels and channels."""
    return float(np.mean(difference**2 / (true**2 + _DARK)))


def is_same_scene(kept: Reference, passes: Passes, pass_of: Callable[[Passes], np.ndarray]) -> bool:
    """Whether the exact passes are of the scene that a reference was made of."""
    if kept.first.shape[:2] != passes.shape:
        return False
    now, then = pass_of(passes), kept.first
    seen = (now[..., 3] > 0) | (then[..., 3] > 0)
    if not seen.any():
        return True
    colour, alpha = (np.abs(now - then)[seen][..., part].max(axis=-1) for part in (slice(3), slice(3, 4)))
    same = np.quantile(colour, 0.99) <= 0.01 * np.abs(then[seen][..., :3]).mean()
    return bool(same and np.quantile(alpha, 0.99) < 0.01)
