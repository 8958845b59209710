"""Distillation error: how different a surface material looks from what it was distilled from, by footprint.

Notation
radius       standard deviation of a pixel's footprint, periods; pixels are two of them apart
picture      SIDE² pixels of a cylinder, seen from one direction under LIGHTS; curvature (in the trained range) and directions
             are drawn anew for each picture. The exposure makes opaque pixels middle grey on average; the background has
             radiance BEHIND. The source's picture is the mean of RAYS a pixel
error        FLIP between the material's picture and the source's: 0 is the same, 1 the most
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from mesoshell.datasets.queries.render import MIN_COSINE, Answers, rows_of
from mesoshell.datasets.queries.tile import PatchPlacement
from mesoshell.io.query_dataset import ALPHA, RGB
from mesoshell.measure.flip import flip
from mesoshell.render.light import LUMINANCE
from mesoshell.scene.defaults import BOUNCE, FILL

SIDE, PICTURES, RAYS, BEHIND = 32, 24, 8, 0.18
#: Irradiances of a scene's default lights.
LIGHTS = (1.0, FILL, BOUNCE)
GREY = 0.18

#: From rows of queries to α, the silhouette cosine and ρ.
Predictor = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def errors_by_radius(
    answers: Answers, predict: Predictor, curvature: tuple[float, float], narrowest: float, widest: float
) -> tuple[tuple[float, float], ...]:
    """(radius, error) for each of `radii`: the mean over pictures, plus 1.96 standard errors."""
    errors = []
    for k, radius in enumerate(radii(narrowest, widest)):
        each = [_error(answers, predict, curvature, radius, np.random.default_rng([k, i])) for i in range(PICTURES)]
        errors.append((radius, float(np.mean(each) + 1.96 * np.std(each, ddof=1) / PICTURES**0.5)))
    return tuple(errors)


def radii(narrowest: float, widest: float) -> tuple[float, ...]:
    """Octaves from the narrowest radius, or just above it, to the widest."""
    return tuple(float(r) for r in widest / 2.0 ** np.arange(int(np.log2(widest / narrowest)), -1, -1))


def _error(
    answers: Answers, predict: Predictor, curvature: tuple[float, float], radius: float, random: np.random.Generator
) -> float:
    placing = PatchPlacement(random.uniform(*curvature), random.uniform(0, 2 * np.pi), tuple(random.random(2)))
    cosine = max(MIN_COSINE, random.random() ** 0.5)  # distributed as over the pixels of a sphere
    i = (np.arange(SIDE) + 0.5 - SIDE / 2) * 2 * radius
    n = SIDE**2
    query = {
        "place": np.stack(np.meshgrid(i, i), axis=-1).reshape(n, 2),
        "radius": np.full(n, radius),
        "toward": np.tile([np.sqrt(1 - cosine**2), 0, cosine], (n, 1)),
    }
    true, ours, alpha_true, alpha_ours = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n)
    for irradiance in LIGHTS:
        up, around = random.random(), random.uniform(0, 2 * np.pi)
        level = np.sqrt(1 - up**2)
        light = np.tile([level * np.cos(around), level * np.sin(around), up], (n, 1))
        lit, seeds = query | {"light": light}, random.integers(2**31, size=RAYS)
        each = [rows_of(placing, lit, answers(placing, lit, int(seed))[0], 0) for seed in seeds]
        rows = np.mean(each, axis=0)
        alpha, _, rho = predict(rows)
        true += irradiance * rows[:, RGB]
        ours += irradiance * alpha[:, None] * rho
        alpha_true, alpha_ours = alpha_true + rows[:, ALPHA] / len(LIGHTS), alpha_ours + alpha / len(LIGHTS)
    exposure = GREY * alpha_true.mean() / max(float(true.mean(axis=0) @ LUMINANCE), 1e-6)
    return flip(_shown(alpha_true, exposure * true), _shown(alpha_ours, exposure * ours))


def _shown(alpha: Float[np.ndarray, "N"], rgb: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "S S 3"]:
    return (rgb + (1 - alpha)[:, None] * BEHIND).reshape(SIDE, SIDE, 3)
