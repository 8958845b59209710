"""What follows from a generator's configuration alone: layers, frequencies, and the samples that each layer needs.

Notation
texels      of F a patch; the plane's grid of rate s has its sample i at (i + ½)/s patches
tile        a rectangle of the plane; it begins at whole cells, of which a patch has CELL
span        samples of a layer along one axis for a tile: the tile and the reach of the layers after it
halo        the part of a span beyond its tile
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Int

from mesoshell.signal.fourier import draw_drift, draw_frequencies, rotate_frequencies
from mesoshell.signal.schedule import Config, LayerRow, layer_schedule

#: Cells a patch: the rate of the coarsest layer. Tiles begin at whole cells.
CELL = 16
#: Slow waves that make up a drift; cycles a patch by which a drift may change a sinusoid's frequency.
SLOW, ASIDE = 8, 2.0


@dataclass(frozen=True)
class GeneratorConfig:
    """texels a patch, a power of two; layers before the output; planes: one and a height feature, or three
    (shell/material/triplane); waves: sinusoids a channel of a Fourier map; drift: of their phases, radians (signal/fourier; the
    paper has 1 and 0, and docs/results/generator.md: why presets have more); fourier: maps in every layer with phases drawn a
    texture ("random"), always the same ("frozen"), or none beyond the input ("off"); z: numbers of the latent, 0 for none:
    textures differ by their phases alone; turn: of maps without drift about the origin, degrees from v toward u; precision: of
    the convolutions. A new field's default must mean the earlier behaviour: bundles and records may lack the field."""

    texels: int = 64
    config: Config = "T"
    channel_base: int = 4096
    channel_max: int = 64
    channels: int = 32
    layers: int = 14
    planes: Literal[1, 3] = 1
    waves: int = 1
    drift: float = 0.0
    z: int = 64
    w: int = 64
    betas: int = 0
    height_rows: int = 64
    height_octaves: int = 5
    height_width: int = 64
    fourier: Literal["random", "frozen", "off"] = "random"
    turn: float = 0.0
    precision: Literal["float32", "bfloat16"] = "float32"
    seed: int = 0


@lru_cache
def rows_of(config: GeneratorConfig) -> tuple[LayerRow, ...]:
    """The layer table of a configuration (signal/schedule)."""
    sizes = config.channel_base, config.channel_max, config.planes * config.channels, config.layers
    return tuple(layer_schedule(config.texels, config.config, *sizes))


class Frequencies(NamedTuple):
    """f of the input's map and of each layer's, which lie between the cutoffs of the layer's input and output; and δ."""

    input: Int[np.ndarray, "C 2"]
    layers: list[Int[np.ndarray, "_c 2"]]
    slow: Int[np.ndarray, "I 2"]


@lru_cache
def frequencies_of(config: GeneratorConfig) -> Frequencies:
    """Frequencies of all maps, drawn by the configuration's seed. Raises ValueError if maps drift and turn."""
    if config.turn and config.drift:
        raise ValueError("maps whose phases drift cannot be turned")
    rng, rows = np.random.default_rng(config.seed), rows_of(config)
    first = rotate_frequencies(
        draw_frequencies(rng, config.waves * rows[0].in_channels, 0.0, rows[0].in_cutoff), config.turn
    )
    layers = []
    for i, row in enumerate(rows):
        low = 0.0 if i == 0 else row.in_cutoff
        high = min(row.out_cutoff, row.in_sampling_rate / 2 - ASIDE * (config.drift > 0))
        empty = low >= high or config.fourier == "off"
        drawn = draw_frequencies(rng, 0 if empty else config.waves * row.in_channels, low, max(low, high))
        layers.append(rotate_frequencies(drawn, config.turn))
    return Frequencies(first, layers, draw_drift(rng, SLOW if config.drift else 0))


class Span(NamedTuple):
    """Where a layer is evaluated, along one axis: its input's first sample and size, and its activation's padding."""

    first: int
    size: int
    pad: tuple[int, int]


def spans(rows: tuple[LayerRow, ...], texels: int) -> list[Span]:
    """Spans of the layers, first to last, for `texels` outputs from 0 on (docs/concepts/generator.md).

    Sample j of a grid lies in the middle of u samples of one u times finer. With taps centred on such middles, output i of
    a down-sampling sees fine samples di − (n − d)/2 … di + (n + d)/2 − 1, and a fine sample f sees the j for which
    0 ≤ uj − f + (u + n)/2 − 1 < n.
    """
    a, b = 0, texels
    layers = []
    for row in reversed(rows):
        u, d, up, down = row.up_factor, row.down_factor, row.up_taps, row.down_taps
        f0, f1 = d * a - (down - d) // 2, d * (b - 1) + (down + d) // 2
        shift = (u + up) // 2 - 1
        j0, j1 = ceil((f0 - shift) / u), floor((f1 - 1 - shift + up - 1) / u) + 1
        before = u * j0 - f0 + shift
        after = (f1 - f0) + up - 1 - u * (j1 - j0) - before
        reach = row.conv_kernel // 2
        a, b = j0 - reach, j1 + reach
        layers.append(Span(a, b - a, (before, after)))
    return layers[::-1]


def reach(config: GeneratorConfig, size: tuple[int, int]) -> int:
    """Patches, rounded up, that the layers for a tile of `size` texels read beyond it on any side."""
    most = 0.0
    for side in size:
        for row, span in zip(rows_of(config), spans(rows_of(config), side), strict=True):
            first, end = (x / row.in_sampling_rate for x in (span.first, span.first + span.size))
            most = max(most, -first, end - side / config.texels)
    return ceil(most)


def halo_cost(config: GeneratorConfig, side: int) -> float:
    """Multiplications of a square tile of `side` texels, halo included, over those of its own samples alone."""
    rows = rows_of(config)
    work = [row.conv_kernel**2 * row.in_channels * row.out_channels for row in rows]
    spent = [(span.size - row.conv_kernel + 1) ** 2 for row, span in zip(rows, spans(rows, side), strict=True)]
    own = [(side * row.in_sampling_rate / config.texels) ** 2 for row in rows]
    return float(np.dot(work, spent) / np.dot(work, own))
