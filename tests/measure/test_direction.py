"""Directions: of waves and of leaning strands whose angle is known, at every quarter of the circle."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mesoshell.measure.direction import leans, mean_error, strokes


def strands(angle: float, run: float, layers: int = 24, side: int = 48, every: float = 0.5) -> np.ndarray:
    """Blobs on a torus that move by `run` layers' spacing a layer toward the angle. every: texels a spacing of layers."""
    rng = np.random.default_rng(5)
    base = gaussian_filter((rng.uniform(size=(side, side)) < 0.05).astype(float), 1.2, mode="wrap")
    fv, fu = np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side), indexing="ij")
    shifts = every * run * np.arange(layers)
    turned = [
        np.fft.fft2(base) * np.exp(-2j * np.pi * s * (fu * math.cos(angle) + fv * math.sin(angle))) for s in shifts
    ]
    return np.stack([np.fft.ifft2(x).real for x in turned])


@pytest.mark.parametrize("degrees", [0, 35, 90, 160, 225, 310])
def test_a_lean_has_a_sign(degrees) -> None:
    angle = math.radians(degrees)
    found, size = leans(strands(angle, 0.8), (0.5, 1.0), (2, 2))
    assert mean_error(found, np.full((2, 2), angle), 2 * math.pi) < math.radians(6)
    np.testing.assert_allclose(size, 0.8, rtol=0.15)


def test_upright_strands_have_no_lean() -> None:
    assert leans(strands(0.0, 0.0), (0.5, 1.0), (1, 1))[1][0, 0] < 0.02


@pytest.mark.parametrize("degrees", [0, 20, 90, 135, 170])
def test_strokes_run_along_a_wave_s_crests(degrees) -> None:
    angle = math.radians(degrees)
    v, u = np.mgrid[:64, :64]
    wave = np.sin(0.7 * (v * math.cos(angle) - u * math.sin(angle)))
    found, coherence = strokes(wave, (4, 4))
    assert mean_error(found, np.full((4, 4), angle), math.pi) < 1e-2
    assert coherence.min() > 0.97
    opposite = strokes(wave[::-1, ::-1], (4, 4))[0]
    assert mean_error(opposite, found, math.pi) < 1e-2  # half a turn is not seen


def test_noise_and_nothing_are_not_coherent() -> None:
    noise = np.random.default_rng(0).normal(size=(128, 128))
    assert strokes(noise, (1, 1))[1][0, 0] < 0.01
    assert strokes(np.zeros((16, 16)), (1, 1))[1][0, 0] == 0


def test_errors_go_around() -> None:
    assert mean_error(np.array([0.1]), np.array([2 * math.pi - 0.1]), 2 * math.pi) == pytest.approx(0.2)
    assert mean_error(np.array([0.1]), np.array([math.pi + 0.2]), math.pi) == pytest.approx(0.1)
    guessed = np.random.default_rng(0).uniform(0, 2 * math.pi, 20000)
    assert mean_error(guessed, np.zeros(20000), 2 * math.pi) == pytest.approx(math.pi / 2, rel=0.02)
