"""A start from which an untrained generator makes what exemplars are at large: their mean, covariance, and power by octave.

Notation
x           what the untrained generator gives, WIDE channels                     (B, S, S, W)
A, b        F = A x + b: the C largest principal components of x, brought to unit variance, turned at random, and given the
            exemplars' correlation                                                (W, C), (C,)
a_l         strengths of the generator's Fourier maps (shell/generator/generator)
band        an octave of frequencies: 2ⁱ to 2ⁱ⁺¹ cycles a tile

A random field with the exemplars' spectrum is the natural start: without it fine scales begin with next to nothing, and least
squares needs hundreds of steps to find them (docs/results/generator.md). A wide x has C components that are not nothing by
chance.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.shell.generator.generator import (
    Averages,
    Generator,
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
    synthesise,
)
from mesoshell.shell.generator.plan import GeneratorConfig, frequencies_of, rows_of
from mesoshell.typing import Array, Float, Key

#: Textures that are looked at, texels of a side of theirs, rounds of solving, and passes that settle magnitudes.
_TEXTURES, _SIDE, _ROUNDS, _PASSES = 8, 64, 8, 3
_BANDS = 5
SETTLE, CORRECT, LOOK = range(3)


class Natural(NamedTuple):
    """Where learning begins; a generator of WIDE channels, and what makes C of them."""

    generator: Generator
    averages: Averages
    a: Float[Array, "W C"]
    b: Float[Array, "C"]


def wide(config: GeneratorConfig) -> GeneratorConfig:
    """The generator that learns: its last layer has twice the channels of a texture."""
    return replace(config, channels=2 * config.channels)


def natural_start(config: GeneratorConfig, features: Float[Array, "K S S C"], key: Key[Array, ""]) -> Natural:
    """A start for exemplars of zero mean and unit variance a channel."""
    return _natural(config, (_TEXTURES, _ROUNDS, _PASSES), features, key)


@partial(jax.jit, static_argnums=(0, 1))
def _natural(
    config: GeneratorConfig, effort: tuple[int, int, int], features: Float[Array, "K S S C"], key: Key[Array, ""]
) -> Natural:
    """In one program, which has the generator once. effort: textures, rounds and passes."""
    textures, rounds, passes = effort
    k, many, side = jax.random.split(key, 4), wide(config), min(_SIDE, features.shape[1])
    wanted = _bands(jnp.stack([_crop(features[i % len(features)], i) for i in range(textures)]))
    generator, averages = init_generator(many, k[0]), init_averages(many)
    phases, beta = draw_phases(many, k[1], textures), jax.random.uniform(k[2], (textures, config.betas), jnp.float32)
    first, places = generator.strength, _places(config, side)

    def look(logs: Array, averages: Averages) -> tuple[Array, Averages]:
        louder = generator._replace(strength=_louder(first, logs))
        w = map_latent(louder, jnp.zeros((textures, config.z), jnp.float32), beta)
        made = synthesise(many, louder, averages, w, phases, jnp.zeros(2, jnp.int32), (side, side))
        return made.feature, Averages(made.magnitude, jnp.mean(w, axis=0))

    def one(so_far: tuple[Array, Averages, Array], what: Array) -> tuple[tuple[Array, Averages, Array], None]:
        """Magnitudes settle, or strengths are corrected by what is missing in each octave, or neither."""
        logs, averages, _ = so_far
        x, seen = look(logs, averages)
        missing = 0.5 * jnp.log(jnp.maximum(wanted, 1e-6) / jnp.maximum(_bands(x), 1e-6))
        more = jnp.clip(logs + 0.5 * jnp.interp(places, jnp.arange(_BANDS, dtype=logs.dtype), missing), -3, 3)
        averages = jax.tree.map(lambda new, old: jnp.where(what == SETTLE, new, old), seen, averages)
        return (jnp.where(what == CORRECT, more.astype(logs.dtype), logs), averages, x), None

    steps = [SETTLE] * 4 * passes + ([CORRECT] + [SETTLE] * passes) * rounds + [LOOK]
    nothing = jnp.zeros((textures, side, side, many.channels), jnp.float32)
    none = jnp.zeros(len(first), jnp.float32)
    (logs, averages, x), _ = jax.lax.scan(one, (none, averages, nothing), jnp.asarray(steps))
    a, b = _as_covariant(x.reshape(-1, many.channels), features.reshape(-1, features.shape[3]), k[3])
    return Natural(generator._replace(strength=_louder(first, logs)), averages, a, b)


def _louder(strengths: list[Array], logs: Float[Array, "l"]) -> list[Array]:
    return [s * jnp.exp(g) for s, g in zip(strengths, logs, strict=True)]


def _crop(f: Float[Array, "S S C"], i: int) -> Float[Array, "s s C"]:
    """A window of a texture that wraps around, another for each i."""
    side = min(_SIDE, f.shape[0])
    return jnp.roll(f, (17 * i, 31 * i), axis=(0, 1))[:side, :side]


def _bands(x: Float[Array, "B S S C"]) -> Float[Array, "n"]:
    """Share of the power in each octave, under a Hann window."""
    x = x - jnp.mean(x, axis=(1, 2), keepdims=True)
    n = x.shape[1]
    window = jnp.hanning(n)
    power = jnp.mean(
        jnp.sum(jnp.abs(jnp.fft.fft2(x * (window[:, None] * window[None])[None, :, :, None], axes=(1, 2))) ** 2, -1), 0
    )
    k = jnp.fft.fftfreq(n, 1 / n)
    r = jnp.hypot(k[:, None], k[None])
    bands = jnp.stack([jnp.sum(jnp.where((r >= 2**i) & (r < 2 ** (i + 1)), power, 0.0)) for i in range(_BANDS)])
    return bands / jnp.sum(bands)


def _places(config: GeneratorConfig, side: int) -> Float[Array, "l"]:
    """Where the layers that have maps lie among the bands."""
    rows = [row for row, f in zip(rows_of(config), frequencies_of(config).layers, strict=True) if len(f)]
    middle = [math.sqrt(max(row.in_cutoff, 1) * max(row.out_cutoff, 1)) * side / config.texels for row in rows]
    return jnp.asarray([min(max(math.log2(m), 0.0), _BANDS - 1.0) for m in middle])


def _as_covariant(
    x: Float[Array, "N W"], f: Float[Array, "M C"], key: Key[Array, ""]
) -> tuple[Float[Array, "W C"], Float[Array, "C"]]:
    """A and b."""
    c = f.shape[1]
    product = partial(jnp.matmul, precision="highest")
    mean = jnp.mean(x, axis=0)
    values, vectors = jnp.linalg.eigh(product((x - mean[None]).T, x - mean[None]) / len(x))
    values, vectors = values[-c:], vectors[:, -c:]
    turn = jnp.linalg.qr(jax.random.normal(key, (c, c), jnp.float32))[0]
    apart = f - jnp.mean(f, axis=0, keepdims=True)
    own, axes = jnp.linalg.eigh(product(apart.T, apart) / len(f))
    root = product(axes * jnp.sqrt(jnp.maximum(own, own[-1] * 1e-4))[None], axes.T)
    white = vectors / jnp.sqrt(jnp.maximum(values, values[-1] * 1e-6))[None]
    a = product(product(white, turn), root)
    return a, jnp.mean(f, axis=0) - product(mean, a)
