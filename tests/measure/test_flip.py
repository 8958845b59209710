"""FLIP against the authors' own program on pictures given by formulas, and what it must be at its ends."""

import numpy as np
import pytest

from mesoshell.measure.flip import flip, flip_map
from mesoshell.render.quality import PRESETS

Y, X = np.mgrid[:40, :56] / 40
WAVE = np.stack([0.5 + 0.4 * np.sin(9 * X), 0.5 + 0.4 * np.cos(7 * Y), 0.3 + 0.2 * np.sin(11 * (X + Y))], axis=-1)
EDGE = np.where(X[..., None] > 0.7, [0.9, 0.1, 0.2], [0.0, 0.6, 0.1])


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (WAVE, np.roll(WAVE, 2, axis=1), 0.28878656),
        (EDGE, WAVE, 0.88665998),
        (0.02 * WAVE, 0.02 * WAVE + 0.001, 0.04914163),
    ],
    ids=["moved", "other", "dark"],
)
def test_is_the_authors_number(a: np.ndarray, b: np.ndarray, expected: float):
    """Means by version 1.7 of their program at 67.02 pixels a degree, for linear values."""
    assert flip(a, b) == pytest.approx(expected, abs=1e-5)
    assert flip(b, a) == pytest.approx(expected, abs=1e-5)


def test_ends():
    assert flip(WAVE, WAVE) == 0
    far = np.broadcast_to([0.0, 1.0, 0.0], WAVE.shape), np.broadcast_to([0.0, 0.0, 1.0], WAVE.shape)
    assert flip(*far) == pytest.approx(1, abs=1e-6)
    assert flip(*far) == flip(far[0] * 7, far[1] * 9)  # a screen shows no more than 1


def test_what_is_not_seen_from_afar_counts_less():
    checks = 0.5 + 0.3 * ((np.indices(WAVE.shape[:2]).sum(axis=0) % 2) * 2 - 1)[..., None] * np.ones(3)
    near, far = (flip(checks, np.full_like(checks, 0.5), ppd) for ppd in (10.0, 67.0))
    assert near > 3 * far > 0


def test_more_noise_is_a_greater_difference():
    noise = np.random.default_rng(1).normal(size=WAVE.shape)
    found = [flip(WAVE, WAVE + s * noise) for s in (0.001, 0.01, 0.05, 0.2)]
    assert found == sorted(found) and found[-1] > 10 * found[0]
    every = flip_map(WAVE, WAVE + 0.2 * noise)
    assert every.shape == WAVE.shape[:2] and every.min() >= 0 and every.max() <= 1


def test_a_step_of_lightness_that_one_can_just_see():
    """L* by 1, of greys: what the bounds of `Quality.twin` are chosen by, just below one such step and below two."""
    for lightness in (20, 50, 80):
        a, b = (np.full((16, 16, 3), ((l + 16) / 116) ** 3) for l in (lightness, lightness + 1))
        assert flip(a, b) == pytest.approx(0.0575, abs=5e-4)
    assert PRESETS["normal"].twin < 0.0575 < PRESETS["draft"].twin < 2 * 0.0575 and PRESETS["reference"].twin == 0
