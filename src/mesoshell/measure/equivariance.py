"""How exactly a generator's texture follows its Fourier maps: EQ-T and EQ-R (Alias-Free GAN, section 3).

Notation
F, F′       texture, and texture of maps that were moved by d texels along (v, u), or turned about the origin by an angle
expected    F itself moved or turned, by interpolation
EQ          10 log10(4 var F / mean (F′ − expected)²), in dB: F ranges over about ±√var

Only the maps tell the generator where it is, so phases move a texture, and turned frequencies turn it. The error is aliasing in
the layers and, unless d is whole, in the interpolation: a windowed sinc of 32 texels for translations; for rotations quintic
splines of a texture that a sinc has doubled. A turned square of frequencies is another square: EQ-R is of the circle within
both.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import correlate1d, map_coordinates
from scipy.signal import fftconvolve

from mesoshell.shell.generator.generator import Averages, Generator, Phases, synthesise
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, frequencies_of
from mesoshell.signal.fourier import shifted_phase
from mesoshell.signal.kaiser import radial_lowpass
from mesoshell.typing import Array

#: Half the taps of the sinc; patches along the texture that is compared, without its edges.
_REACH, _PATCHES = 16, 2


def eq_t(
    config: GeneratorConfig, maker: tuple[Generator, Averages], w: Array, phases: Phases, d: tuple[float, float]
) -> float:
    """EQ-T in dB. w: (1, W); phases: of one texture."""
    f = frequencies_of(config)
    slow = jnp.asarray(f.slow)
    by = jnp.asarray(np.array(d) / config.texels, jnp.float32)
    moved = Phases(
        shifted_phase(jnp.asarray(f.input), slow, phases.input, by),
        [shifted_phase(jnp.asarray(m), slow, p, by) for m, p in zip(f.layers, phases.layers, strict=True)],
    )
    expected = _texture(config, maker, w, phases)
    for axis, texels in enumerate(d):
        expected = np.roll(expected, int(np.floor(texels)), axis)
        expected = correlate1d(expected, _sinc(texels - np.floor(texels)), axis) if texels % 1 else expected
    return _decibels(expected, _texture(config, maker, w, moved))


def eq_r(config: GeneratorConfig, maker: tuple[Generator, Averages], w: Array, phases: Phases, degrees: float) -> float:
    """EQ-R in dB of what both grids can hold, |f| < 0.4 cycles a texel, within the circle in the middle."""
    once = radial_lowpass(_REACH, 0.4, 0.1, 1.0)
    low = fftconvolve(once, once)[..., None]  # an odd number of taps: centred
    turned, f = (
        fftconvolve(_texture(replace(config, turn=config.turn + by), maker, w, phases), low, "same", axes=(0, 1))
        for by in (degrees, 0.0)
    )
    n, angle = len(f), np.radians(degrees)
    double = np.zeros((2 * n, 2 * n, f.shape[2]))
    for i, a in enumerate((-0.25, 0.25)):
        for j, b in enumerate((-0.25, 0.25)):
            part = correlate1d(correlate1d(f, _sinc(-a), 0), _sinc(-b), 1)
            double[i::2, j::2] = part
    v, u = np.mgrid[:n, :n] + 0.5 - n / 2
    back = np.stack([np.cos(angle) * v + np.sin(angle) * u, np.cos(angle) * u - np.sin(angle) * v])
    at = 2 * (back + n / 2) - 0.5
    expected = np.stack([map_coordinates(double[..., c], at, order=5) for c in range(f.shape[2])], axis=-1)
    return _decibels(expected, turned, np.hypot(v, u) < n / 2 - 2 * _REACH)


def _texture(config: GeneratorConfig, maker: tuple[Generator, Averages], w: Array, phases: Phases) -> np.ndarray:
    """F about the origin, with room for the interpolation's taps."""
    return np.asarray(_made(config, *maker, w, phases), np.float64)


@partial(jax.jit, static_argnums=0)
def _made(config: GeneratorConfig, generator: Generator, averages: Averages, w: Array, phases: Phases) -> Array:
    cells = _PATCHES * CELL // 2 + -(-2 * _REACH * CELL // config.texels)
    side = 2 * cells * config.texels // CELL
    corner = jnp.full(2, -cells, jnp.int32)
    return synthesise(config, generator, averages, w, phases, corner, (side, side)).feature[0]


def _sinc(by: float) -> Float[np.ndarray, "n"]:
    """Taps of correlate1d that move by `by` texels toward greater indices."""
    at = np.arange(-_REACH, _REACH + 1) + by
    window = np.i0(8 * np.sqrt(np.maximum(1 - (at / (_REACH + 1)) ** 2, 0)))
    taps = np.sinc(at) * window
    return taps / taps.sum()


def _decibels(expected: np.ndarray, actual: np.ndarray, where: np.ndarray | None = None) -> float:
    if where is None:
        inner = slice(2 * _REACH, -2 * _REACH)
        expected, actual = expected[inner, inner], actual[inner, inner]
    else:
        expected, actual = expected[where], actual[where]
    return float(10 * np.log10(4 * np.var(expected) / np.mean((actual - expected) ** 2)))
