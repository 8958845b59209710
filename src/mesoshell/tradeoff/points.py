"""Measure settings: seconds and evaluations of a pass, errors after so many.

Notation
I_k         passes of these settings                                                                   (H, W, 4)
T           reference
e(n)        FLIP of the mean of n passes against T, the mean over disjoint groups of n passes, less the noise of T, which is
            independent, and not below that noise. Where passes share rays, pass 0 goes through the pixel's centre and is the
            group of one; larger groups take passes after it, which lie about the centre as evenly as `pixel_samples` = n
q           2/0.7: FLIP grows as the 0.7th power of a small difference of colours, and squares of independent differences add
b, ν        bias and noise, fitted: e(n)^q = b^q + ν^q/n
relative squared error    mean of (I − T)²/(T² + 0.01) over pixels and channels, over the backdrop, linear, with T's noise
bias²       of a point: |mean of I_k − T|² less its variance over k and that of T: free of bias itself if passes are independent
            of each other. Of passes that are even together it takes off too much
"""

import hashlib
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls

from mesoshell.measure.flip import POWER, flip, flip_map
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.picture import Passes, Progress
from mesoshell.tradeoff.knobs import Settings, describe_changes
from mesoshell.tradeoff.reference import Reference, relative

#: Most passes of a point, by whether rays are the same or paths drawn anew; the fewest; seconds after which it has enough.
MAX_PASSES, MIN_PASSES, ENOUGH_SECONDS = {True: 9, False: 64}, 4, 20.0
Q = POWER


@dataclass(frozen=True)
class Point:
    """settings: values of the knobs. seconds: a pass's lower quartile, median and upper quartile; first: of the first pass
    beyond the median: compiling; evaluations: network queries a pixel and pass. samples: n; flip: e(n); spread: standard
    error of e(n), 0 where there is one group; relative: relative squared errors. bias, noise: b and ν. bias2, variance: of the
    relative squared error of one pass."""

    settings: dict[str, Any]
    seconds: tuple[float, float, float]
    first: float
    evaluations: float
    samples: tuple[int, ...]
    flip: tuple[float, ...]
    spread: tuple[float, ...]
    relative: tuple[float, ...]
    bias: float
    noise: float
    bias2: float
    variance: float

    def error(self, n: int) -> float:
        """e(n); of more passes than were measured by b and ν."""
        return (
            self.flip[self.samples.index(n)] if n in self.samples else float(combined_error(self.bias, self.noise, n))
        )

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def of(cls, kept: dict[str, Any]) -> "Point":
        """From JSON."""
        fields: dict[str, Any] = {name: tuple(x) if isinstance(x, list) else x for name, x in kept.items()}
        return cls(**fields)


def combined_error(bias: Any, noise: Any, n: int) -> Any:
    """e(n), of b and ν."""
    return (bias**Q + noise**Q / n) ** (1 / Q)


def measure_point(
    settings: Settings, passes: Passes, reference: Reference, progress: Progress
) -> tuple[Point, np.ndarray]:
    """A point, and its means of n passes, (N, H, W, 4)."""
    alone = int(reference.same_rays)
    images, seconds, queries = _taken(passes, MAX_PASSES[reference.same_rays], alone, progress)
    counts = [2**i for i in range((len(images) - alone).bit_length())]
    groups = {n: images[alone:].reshape(-1, n, *images.shape[1:]).mean(axis=1) for n in counts}
    if alone:
        groups[1] = images[:1]
    true = over_backdrop(reference.image)
    errors = {n: [flip(over_backdrop(g), true) for g in groups[n][:8]] for n in counts}
    means = np.array([np.mean(x) for x in errors.values()])
    e = _less(means, reference.noise)
    spread = [float(np.std(x, ddof=1) / len(x) ** 0.5) if len(x) > 1 else 0.0 for x in errors.values()]
    spread = np.array(spread) * (means / np.maximum(e, 1e-9)) ** (Q - 1)  # as e changes with what was found
    reliable = (e > reference.noise) | (np.arange(len(e)) < 2)
    bias, noise = _fitted(np.array(counts)[reliable], e[reliable])
    shown = over_backdrop(images)
    variance = relative(shown.std(axis=0, ddof=1), true)
    bias2 = relative(shown.mean(axis=0) - true, true) - variance / len(images) - reference.variance
    later = np.array(seconds[1:])
    quartiles = np.percentile(later, [25, 50, 75])
    point = Point(
        settings=dict(settings),
        seconds=(float(quartiles[0]), float(quartiles[1]), float(quartiles[2])),
        first=max(0.0, seconds[0] - float(quartiles[1])),
        evaluations=queries,
        samples=tuple(counts),
        flip=tuple(map(float, e)),
        spread=tuple(map(float, spread)),
        relative=tuple(
            float(np.mean([relative(over_backdrop(g) - true, true) for g in groups[n][:8]])) for n in counts
        ),
        bias=bias,
        noise=noise,
        bias2=bias2,
        variance=variance,
    )
    return point, np.array([groups[n][0] for n in counts])


def _taken(passes: Passes, most: int, alone: int, progress: Progress) -> tuple[np.ndarray, list[float], float]:
    """Pictures of a power of two of passes and of `alone` before these; the seconds of each, and of one before all, which
    compiles; network queries a pixel and pass."""
    pixels, images, seconds, begun = np.arange(passes.shape[0] * passes.shape[1]), [], [], 0.0
    before = 0
    for k in range(-1, most):
        if k - alone >= MIN_PASSES and (k - alone).bit_count() == 1 and time.perf_counter() - begun > ENOUGH_SECONDS:
            break
        begin = time.perf_counter()
        image = passes.render(max(k, 0), pixels, lambda share: None).reshape(*passes.shape, 4)
        seconds.append(time.perf_counter() - begin)
        progress((k + 2) / (most + 1))
        if k < 0:
            begun, before = time.perf_counter(), _queries(passes)
        else:
            images.append(image)
    return np.array(images), seconds, (_queries(passes) - before) / len(images) / len(pixels)


def _queries(passes: Passes) -> int:
    return passes.ended(np.zeros((*passes.shape, 4)), 1).record["queries"]


def _fitted(n: np.ndarray, e: np.ndarray) -> tuple[float, float]:
    """b and ν, by non-negative least squares of relative differences."""
    scale = np.maximum(e, 1e-9) ** -Q
    fit, _ = nnls(np.stack([scale, scale / n], axis=1), np.ones(len(e)), maxiter=1000)
    return float(fit[0] ** (1 / Q)), float(fit[1] ** (1 / Q))


def _less(error: np.ndarray, noise: float) -> np.ndarray:
    """Errors without an independent one, and not below it: what is less cannot be told."""
    return np.maximum(np.maximum(error**Q - noise**Q, 0) ** (1 / Q), np.minimum(error, noise))


def error_map(image: np.ndarray, reference: Reference) -> np.ndarray:
    """FLIP of each pixel, (H, W)."""
    return flip_map(over_backdrop(image), over_backdrop(reference.image))


def picture_path(folder: Path, point: Point) -> Path:
    """The strip of a point's pictures."""
    return folder / "pictures" / f"{hashlib.sha256(describe_changes(point.settings).encode()).hexdigest()[:12]}.png"
