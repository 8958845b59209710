"""Low-pass filters by the Kaiser window, in float64 (Alias-Free GAN, appendix C).

Notation
f_c      cutoff: halfway down the transition band                              cycles a patch
w        half-width of the transition band                                    cycles a patch
s        sampling rate of the filter                                          samples a patch
n, x     number of taps; their positions about the middle, in patches
"""

import numpy as np
from jaxtyping import Float
from scipy.signal import kaiser_atten, kaiser_beta
from scipy.special import j1


def lowpass(taps: int, cutoff: float, half_width: float, rate: float) -> Float[np.ndarray, "n"]:
    """sinc times the Kaiser window whose transition band is 2w wide; taps sum to 1."""
    x = _positions(taps, rate)
    f = np.sinc(2 * cutoff * x) * _window(taps, half_width, rate)
    return f / f.sum()


def radial_lowpass(taps: int, cutoff: float, half_width: float, rate: float) -> Float[np.ndarray, "n n"]:
    """The same with a disc for its passband: jinc(2 f_c r) times the window along both axes. `taps` is even."""
    x = _positions(taps, rate)
    r = np.hypot(*np.meshgrid(x, x))
    window = _window(taps, half_width, rate)
    f = j1(2 * np.pi * cutoff * r) / r * np.outer(window, window)
    return f / f.sum()


def _positions(taps: int, rate: float) -> Float[np.ndarray, "n"]:
    return (np.arange(taps) - (taps - 1) / 2) / rate


def _window(taps: int, half_width: float, rate: float) -> Float[np.ndarray, "n"]:
    return np.kaiser(taps, kaiser_beta(kaiser_atten(taps, 2 * half_width / (rate / 2))))
