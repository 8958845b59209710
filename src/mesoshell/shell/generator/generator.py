"""The generator of feature textures (MesoGAN, section 4.1, on Alias-Free GAN's layers).

Notation
z, β        latent, drawn at random, and geometry parameters in [0, 1]            (B, Z), (B, G)
w           mapped latent, source of styles: mapping(z, β)                        (B, W), or on nodes about a tile (nodes.py)
Γ_l         Fourier map added to the input of layer l (signal/fourier)
φ_l         its phases                                                            cycles, (B, J, waves · C_l)
a_l         strength of Γ_l, learned                                               (C_l,)
F           feature texture                                                       (B, v, u, C)
F(h)        height feature                                                        (B, R, C)
texels      of F a patch; the plane's grid of rate s has its sample i at (i + ½)/s patches
tile        a place in the plane, counted in CELL = 1/16 patches along v and u: the coarsest layers' samples

The plane has no edge: a layer is evaluated where the next one needs it, without padding, so a tile computes a halo of two
to three patches that its neighbours compute too, and a tile of a large texture is the same as a training patch. The first
layer's input is a Fourier map, mixed by a matrix. Frequencies belong to the generator, phases to a texture. What follows from
the configuration alone is in shell/generator/plan.

Magnitudes (running mean squares of the layers' inputs, Alias-Free GAN's equation in appendix C) are state: they are arguments,
and the observed values are returned.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.mlp import Dense
from mesoshell.shell.generator.nodes import hat, spread_out
from mesoshell.shell.generator.plan import CELL, GeneratorConfig, Span, frequencies_of, reach, rows_of, spans
from mesoshell.signal.filtered_lrelu import Activation, filtered_lrelu
from mesoshell.signal.fourier import fourier_map
from mesoshell.signal.modulated import modulated_conv
from mesoshell.signal.schedule import LayerRow
from mesoshell.typing import Array, Float, Int, Key

#: Scales of the last layers' outputs for F(u, v) and for F(h): so σ begins to vary in the plane. (At 0.25 for both, 93% of
#: log σ's variance came from the height: the material began, and stayed, as layers.)
PLANE_SCALE, HEIGHT_SCALE = 3.0, 0.25
_MAPPING_RATE = 0.01


class Styled(NamedTuple):
    """A modulated layer: weights (k, k, I, O), bias (O,), and the affine map from w to the styles of its inputs."""

    weight: Float[Array, "k k I O"]
    bias: Float[Array, "O"]
    affine: Dense


class Generator(NamedTuple):
    """Learned parameters. mix: (C0, C0) of the input's Fourier map; strength: a_l of each layer with a map; height: modulated
    layers along h."""

    mapping: list[Dense]
    mix: Float[Array, "C C"]
    strength: list[Float[Array, "_c"]]
    layers: list[Styled]
    height: list[Styled]


class Averages(NamedTuple):
    """State that is not trained: mean squares of the layers' inputs, and the mean of w."""

    magnitude: list[Float[Array, ""]]
    w: Float[Array, "W"]


class Phases(NamedTuple):
    """φ of the input's map and of each layer's; a layer without a map has no channels."""

    input: Float[Array, "B J C"]
    layers: list[Float[Array, "B J _c"]]


@partial(jax.jit, static_argnums=0)
def init_generator(config: GeneratorConfig, key: Key[Array, ""]) -> Generator:
    """Unit normal weights throughout, scaled when used, so that all learn at one rate."""
    keys = iter(jax.random.split(key, 64))
    rows, maps = rows_of(config), frequencies_of(config).layers

    def dense(inputs: int, outputs: int, bias: float, scale: float = 1.0) -> Dense:
        kernel = jax.random.normal(next(keys), (inputs, outputs), jnp.float32) * scale
        return Dense(kernel, jnp.full(outputs, bias, jnp.float32))

    def styled(k: int, inputs: int, outputs: int) -> Styled:
        weight = jax.random.normal(next(keys), (k, k, inputs, outputs), jnp.float32)
        return Styled(weight, jnp.zeros(outputs, jnp.float32), dense(config.w, inputs, 1.0))

    c0, encoded, wide = rows[0].in_channels, 1 + 2 * config.height_octaves, config.height_width
    embed = [dense(3 * config.betas, config.w, 0.0)] if config.betas else []
    hidden = [max(config.z, 1) + config.w * bool(config.betas), config.w]
    return Generator(
        mapping=[*embed, *(dense(n, config.w, 0.0, 1 / _MAPPING_RATE) for n in hidden)],
        mix=jax.random.normal(next(keys), (c0, c0), jnp.float32),
        strength=[
            jnp.full(row.in_channels, (2 / (i + 1)) ** 0.5, jnp.float32) for i, row in enumerate(rows) if len(maps[i])
        ],
        layers=[styled(row.conv_kernel, row.in_channels, row.out_channels) for row in rows],
        height=[styled(1, encoded, wide), styled(1, wide, wide), styled(1, wide, config.channels)]
        if config.planes == 1
        else [],
    )


def init_averages(config: GeneratorConfig) -> Averages:
    """Averages before training: magnitudes of 1, and a mean w of 0."""
    return Averages([jnp.ones((), jnp.float32) for _ in rows_of(config)], jnp.zeros(config.w, jnp.float32))


def draw_phases(config: GeneratorConfig, key: Key[Array, ""], batch: int) -> Phases:
    """φ ~ U(0, 1), for each texture of the batch; the same for all calls if they are frozen."""
    key = jax.random.key(config.seed) if config.fourier == "frozen" else key
    f = frequencies_of(config)
    keys, same = jax.random.split(key, 1 + len(f.layers)), config.fourier == "frozen"

    def drawn(k: Array, sinusoids: int) -> Array:
        shape = (1 + f.slow.size, sinusoids)
        phases = jax.random.uniform(k, (1 if same else batch, *shape), jnp.float32)
        return jnp.broadcast_to(phases, (batch, *shape))

    return Phases(drawn(keys[0], len(f.input)), [drawn(k, len(m)) for k, m in zip(keys[1:], f.layers, strict=True)])


def map_latent(generator: Generator, z: Float[Array, "B Z"], beta: Float[Array, "B G"]) -> Float[Array, "B W"]:
    """w from z and β: both normalised to unit mean square, then two layers that learn a hundred times slower. Without a latent
    (z of no numbers) a 1 takes its place."""
    layers, x = generator.mapping, _unit(z) if z.shape[1] else jnp.ones((z.shape[0], 1), z.dtype)
    if beta.shape[1]:
        x = jnp.concatenate([x, _unit(_equal(layers[0], in_turns(beta)))], axis=1)
        layers = layers[1:]
    for layer in layers:
        x = jax.nn.leaky_relu(_equal(layer, x, _MAPPING_RATE), 0.2) * 2**0.5
    return x


def in_turns(x: Float[Array, "B N"]) -> Float[Array, "B _three_n"]:
    """Encode parameters in [0, 1]: centred, and as sine and cosine of a full turn. So both ends of an angle can look alike to a
    network, and the vector to normalise is never zero."""
    return jnp.concatenate([2 * x - 1, jnp.sin(2 * jnp.pi * x), jnp.cos(2 * jnp.pi * x)], axis=1)


def _unit(x: Float[Array, "B N"]) -> Float[Array, "B N"]:
    return x * jax.lax.rsqrt(jnp.mean(x**2, axis=1, keepdims=True) + 1e-8)


def _equal(layer: Dense, x: Float[Array, "B *nodes I"], rate: float = 1.0) -> Float[Array, "B *nodes O"]:
    """A dense layer whose weights are scaled here: kernel by rate/√I, bias by the rate."""
    y = jnp.matmul(x, layer.kernel * (rate / layer.kernel.shape[0] ** 0.5), precision="highest")
    return y + jnp.broadcast_to(layer.bias * rate, y.shape)


class Texture(NamedTuple):
    """A tile, and the mean squares of the layers' inputs."""

    feature: Float[Array, "B V U C"]
    magnitude: list[Float[Array, ""]]


def synthesise(
    config: GeneratorConfig,
    generator: Generator,
    averages: Averages,
    w: Float[Array, "B *nodes W"],
    phases: Phases,
    tile: Int[Array, "2"],
    size: tuple[int, int],
) -> Texture:
    """F on `size` texels along (v, u) from the tile's corner on. w on nodes: from `reach` patches before that corner on."""
    rows = rows_of(config)
    frequencies = frequencies_of(config)
    along = list(zip(spans(rows, size[0]), spans(rows, size[1]), strict=True))

    def wave(f: np.ndarray, phase: Array, row: LayerRow, at: tuple[Span, Span]) -> Array:
        size, slow = (at[0].size, at[1].size), jnp.asarray(frequencies.slow)
        rate = int(row.in_sampling_rate)
        start = tile * (rate // CELL) + jnp.array([at[0].first, at[1].first], jnp.int32)
        return fourier_map(jnp.asarray(f), slow, phase, start, size, rate, config.waves, config.drift)

    def styled(layer: Styled, row: LayerRow, at: tuple[Span, Span]) -> Array:
        style = _style(layer, w, row.is_torgb)
        if style.ndim == 2:
            return style
        before = reach(config, size)
        axes = zip(at, style.shape[1:3], strict=True)
        v, u = (hat(a.first, a.size, row.in_sampling_rate, before, n) for a, n in axes)
        return spread_out(style, (v, u))

    short = jnp.bfloat16 if config.precision == "bfloat16" else w.dtype
    mix = generator.mix / generator.mix.shape[0] ** 0.5
    x = jnp.matmul(wave(frequencies.input, phases.input, rows[0], along[0]), mix, precision="highest")
    magnitudes, strength = [], iter(generator.strength)
    for i, (row, layer, at) in enumerate(zip(rows, generator.layers, along, strict=True)):
        if len(frequencies.layers[i]):
            x = x + wave(frequencies.layers[i], phases.layers[i], row, at) * next(strength)[None, None, None]
        magnitudes.append(jax.lax.stop_gradient(jnp.mean(x.astype(jnp.float32) ** 2)))
        how = Activation(row, (*at[1].pad, *at[0].pad))
        layer = layer._replace(weight=layer.weight.astype(short))
        x = filtered_lrelu(_modulated(layer, x, styled(layer, row, at), averages.magnitude[i], row.is_torgb), how)
    return Texture(PLANE_SCALE * x, magnitudes)


def synthesise_height(config: GeneratorConfig, generator: Generator, w: Float[Array, "B W"]) -> Float[Array, "B R C"]:
    """F(h) at the middles of `height_rows` equal parts of [0, 1]: sines of h through modulated layers. 0 for three planes."""
    rows = config.height_rows
    if config.planes > 1:
        return jnp.zeros((w.shape[0], rows, config.channels), w.dtype)
    h = (jnp.arange(rows, dtype=w.dtype) + 0.5) / rows
    angle = jnp.pi * h[:, None] * 2.0 ** jnp.arange(config.height_octaves, dtype=w.dtype)[None]
    x = jnp.concatenate([2 * h[:, None] - 1, jnp.sin(angle), jnp.cos(angle)], axis=1)
    x = jnp.broadcast_to(x[None, :, None], (w.shape[0], rows, 1, x.shape[1]))
    one = jnp.ones((), w.dtype)
    for layer in generator.height[:-1]:
        x = jax.nn.leaky_relu(_modulated(layer, x, _style(layer, w, False), one, False), 0.2) * 2**0.5
    last = generator.height[-1]
    return HEIGHT_SCALE * _modulated(last, x, _style(last, w, True), one, True)[:, :, 0]


def _style(layer: Styled, w: Float[Array, "B *nodes W"], last: bool) -> Array:
    style = _equal(layer.affine, w)
    return style / style.shape[-1] ** 0.5 if last else style


def _modulated(layer: Styled, x: Array, style: Array, magnitude: Float[Array, ""], last: bool) -> Array:
    gain = jax.lax.rsqrt(magnitude).astype(x.dtype)
    y = modulated_conv(x, layer.weight, style.astype(x.dtype), gain, not last, 0)
    return y + layer.bias.astype(x.dtype)[None, None, None]
