"""The layers of an alias-free generator: rates, cutoffs, sizes, channels and filters (Alias-Free GAN, section 3.2).

Notation
i            layer, 0 … N; N (14 in the papers) is the output, the two layers before it are critically sampled
f_c, f_t     cutoff and stopband of a layer's output, geometric from 2 and 2^2.1 to res/2 and 2^0.3·res/2     cycles a patch
s            sampling rate: the least power of two ≥ 2f_t, at most res                                        samples a patch
half-width   of the transition band: max(f_t, s/2) − f_c                                                      cycles a patch

Between its convolution and its down-sampling a layer works at the temporary rate, twice the larger of input and output.
Config T has 3 × 3 convolutions and separable filters; R has 1 × 1 with twice the channels, and its down-sampling filters
are radial except where sampling is critical. Sizes carry the margin of 10 samples of zero-padded training at a fixed size;
`mesoshell.shell.generator.generator` runs the same layers without padding and takes all but the sizes and paddings.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mesoshell.signal.kaiser import lowpass, radial_lowpass

Config = Literal["T", "R"]

CRITICAL, MARGIN, FILTER_SIZE = 2, 10, 6
FIRST_CUTOFF, FIRST_STOPBAND, LAST_STOPBAND = 2.0, 2**2.1, 2**0.3
#: For more, a generator draws no weights (shell/generator/generator).
MOST_LAYERS = 26


@dataclass(frozen=True, eq=False)
class LayerRow:
    """One layer. Sizes are [width, height] in samples; padding (x before, x after, y before, y after) at the temporary rate.

    Filters are (taps,) or, where `down_radial`, (taps, taps); None where the factor is 1.
    """

    name: str
    is_torgb: bool
    is_critically_sampled: bool
    in_channels: int
    out_channels: int
    in_size: list[int]
    out_size: list[int]
    in_sampling_rate: float
    out_sampling_rate: float
    tmp_sampling_rate: float
    in_cutoff: float
    out_cutoff: float
    in_half_width: float
    out_half_width: float
    conv_kernel: int
    up_factor: int
    down_factor: int
    up_taps: int
    down_taps: int
    padding: list[int]
    up_filter: np.ndarray | None
    down_filter: np.ndarray | None
    down_radial: bool


def layer_schedule(
    resolution: int,
    config: Config = "T",
    channel_base: int = 32768,
    channel_max: int = 512,
    out_channels: int = 3,
    layers: int = 14,
) -> list[LayerRow]:
    """Rows 0 … N = layers for `resolution` samples a patch at the output. Raises ValueError if it is no power of two ≥ 16,
    or there are fewer than 4 layers, or more than MOST_LAYERS."""
    if resolution < 16 or resolution & (resolution - 1):
        raise ValueError(f"resolution must be a power of two and at least 16, not {resolution}")
    if layers < 4:
        raise ValueError(f"layers must be at least 4, not {layers}")
    if layers > MOST_LAYERS:
        raise ValueError(f"layers must be at most {MOST_LAYERS}, not {layers}")
    e = np.minimum(np.arange(layers + 1) / (layers - CRITICAL), 1)
    last = resolution / 2
    cutoff = FIRST_CUTOFF * (last / FIRST_CUTOFF) ** e
    stopband = FIRST_STOPBAND * (last * LAST_STOPBAND / FIRST_STOPBAND) ** e
    rate = 2 ** np.ceil(np.log2(np.minimum(2 * stopband, resolution)))
    half_width = np.maximum(stopband, rate / 2) - cutoff
    size = rate + 2 * MARGIN
    size[-CRITICAL:] = resolution
    wide = 2 if config == "R" else 1
    channels = np.rint(np.minimum(wide * channel_base / 2 / cutoff, wide * channel_max))
    channels[-1] = out_channels
    sides = [_Side(*map(float, column)) for column in zip(cutoff, half_width, rate, size, channels, strict=True)]
    return [_row(i, layers, config, sides[max(i - 1, 0)], sides[i]) for i in range(layers + 1)]


class _Side(NamedTuple):
    """A layer's input or output."""

    cutoff: float
    half_width: float
    rate: float
    size: float
    channels: float


def _row(i: int, layers: int, config: Config, before: _Side, after: _Side) -> LayerRow:
    output, critical = i == layers, i >= layers - CRITICAL
    tmp = max(before.rate, after.rate) * (1 if output else 2)
    up, down = (1, 1) if output else (int(tmp // before.rate), int(tmp // after.rate))
    up_taps, down_taps = (FILTER_SIZE * n if n > 1 else 1 for n in (up, down))
    radial = config == "R" and not critical
    kernel = 3 if config == "T" and not output else 1
    design = radial_lowpass if radial else lowpass
    total = int((after.size - 1) * down + 1 - (before.size + kernel - 1) * up + up_taps + down_taps - 2)
    first = (total + up) // 2
    return LayerRow(
        name=f"L{i}_{after.size:.0f}_{after.channels:.0f}",
        is_torgb=output,
        is_critically_sampled=critical,
        in_channels=int(before.channels),
        out_channels=int(after.channels),
        in_size=[int(before.size)] * 2,
        out_size=[int(after.size)] * 2,
        in_sampling_rate=before.rate,
        out_sampling_rate=after.rate,
        tmp_sampling_rate=tmp,
        in_cutoff=before.cutoff,
        out_cutoff=after.cutoff,
        in_half_width=before.half_width,
        out_half_width=after.half_width,
        conv_kernel=kernel,
        up_factor=up,
        down_factor=down,
        up_taps=up_taps,
        down_taps=down_taps,
        padding=[first, total - first] * 2,
        up_filter=lowpass(up_taps, before.cutoff, before.half_width, tmp) if up > 1 else None,
        down_filter=design(down_taps, after.cutoff, after.half_width, tmp) if down > 1 else None,
        down_radial=radial,
    )
