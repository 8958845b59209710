"""The picture that all others are measured against.

Notation
R, C        the expected pictures of the preset `reference` and of cheaper settings that differ from it little. R is the same
            with any values of knobs that only add noise, which a path tracer's r_k have from `normal`
r_k, c_k    passes of a ray a pixel of both, at the same rays for the same k
T           R's estimate: the mean of c_k over many k, plus that of r_k − c_k over few: where both see the same rays the
            difference has less noise (two levels of Giles, "Multilevel Monte Carlo methods", 2015). A path tracer's paths are
            not the same, and there T is the mean of r_k. The many are other passes than those of points, an even number
            from an odd k on, so that their rays lie evenly about the pixel's centre
noise       FLIP of T of the first half of passes against T, which estimates that of T against R
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.measure.flip import flip
from mesoshell.render.quality import PRESETS
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.picture import Passes, Progress

#: C, of which there is none for a path tracer; first of T's passes, and so most of a point's, where rays are the same; passes
#: r_k that are kept; most of r_k − c_k; least and most of the many.
CHEAPER = PRESETS["normal"].with_changes(samples=64, spacing="length", light_samples=0, anisotropy=4, twin=0.0)
FIRST, PAIRED, DIFFERENCES, LEAST, MOST = 9, 2, 16, 16, 1024


class Reference(NamedTuple):
    """T; the first r_k; noise; passes of `reference` that T is of, and of cheaper settings, 0 for a path tracer; whether
    passes of other settings see the same rays."""

    image: Float[np.ndarray, "H W 4"]
    first: Float[np.ndarray, "K H W 4"]
    noise: float
    passes: int
    cheaper: int
    same_rays: bool


def refer(
    exact: Passes,
    cheaper: Passes | None,
    seconds: float,
    aim: float,
    progress: Progress,
    stopped: Callable[[], bool] = lambda: False,
) -> Reference:
    """T within about so many seconds; sooner if its noise is at most `aim`, or if `stopped`. cheaper: C's; None if it sees
    other rays."""
    begin, pixels = time.perf_counter(), np.arange(exact.shape[0] * exact.shape[1])
    quiet: Progress = lambda share: None  # noqa: E731

    def one(passes: Passes, k: int) -> np.ndarray:
        progress(min(1.0, (time.perf_counter() - begin) / seconds))
        return passes.render(k, pixels, quiet).reshape(*exact.shape, 4)

    first = np.array([one(exact, k) for k in range(PAIRED)])
    level, at = np.zeros_like(first), 2**20
    if cheaper is not None:
        apart: list[np.ndarray] = []
        while len(apart) < 2 or (len(apart) < DIFFERENCES and time.perf_counter() - begin < seconds / 2):
            apart += [one(exact, k) - one(cheaper, k) for k in (FIRST + len(apart), FIRST + len(apart) + 1)]
        level, at = np.array(apart), FIRST + len(apart)
    many: list[np.ndarray] = []
    noise = np.inf
    late = lambda: time.perf_counter() - begin > seconds or stopped()  # noqa: E731
    while len(many) < LEAST or (noise > aim and len(many) < MOST and not late()):
        many += [one(cheaper or exact, at + len(many) + k) for k in range(max(LEAST, len(many) // 8 * 2))]
        whole = np.mean(many, axis=0) + level.mean(axis=0)
        half = np.mean(many[: len(many) // 2], axis=0) + level[: len(level) // 2].mean(axis=0)
        noise = flip(over_backdrop(half), over_backdrop(whole))
    image, counts = np.mean(many, axis=0) + level.mean(axis=0), (len(level), len(many)) if cheaper else (len(many), 0)
    return Reference(image, first, noise, *counts, cheaper is not None)


def refers_to(kept: Reference, passes: Passes, pass_of: Callable[[Passes], np.ndarray]) -> bool:
    """Whether the exact passes are of the scene that a reference was made of."""
    if kept.first.shape[1:3] != passes.shape:
        return False
    now, then = pass_of(passes), kept.first[0]
    seen = (now[..., 3] > 0) | (then[..., 3] > 0)
    if not seen.any():
        return True
    colour, alpha = (np.abs(now - then)[seen][..., part].max(axis=-1) for part in (slice(3), slice(3, 4)))
    same = np.quantile(colour, 0.99) <= 0.01 * np.abs(then[seen][..., :3]).mean()
    return bool(same and np.quantile(alpha, 0.99) < 0.01)
