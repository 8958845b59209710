"""The generator learns fitted textures, through the decoder that they were fitted with: no ray is traced.

Alphabet
K           exemplars (io/exemplars), each with phases of its own, drawn once
B           rows a step: an exemplar each
F̂, F        what the generator makes of an exemplar's phases and β; the exemplar's texture        (B, S, S, C)
error       mean of (F̂ − F)²; exemplars are scaled to unit variance a channel, so it is the share of the variance that is left
height      the same of F(h), which is one for all

Scaling and mean of the exemplars' channels go into the decoder's first layer: F is (f − mean)/deviation, and the decoder is told
so. A generator learns what regression asks only at the phases that it is shown; what it makes of others depends on how many
those are (docs/generator.md).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mesoshell.errors import InputError
from mesoshell.io.exemplars import Exemplars
from mesoshell.nets.mlp import Dense
from mesoshell.shell.decoder import Decoder
from mesoshell.shell.generator import (
    PLANE_SCALE,
    Averages,
    Generator,
    Phases,
    draw_phases,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.plan import GeneratorConfig
from mesoshell.shell.scene import decoder_of
from mesoshell.train.natural_start import natural_start, wide
from mesoshell.train.step import HERE, Across, not_finite
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

#: Half of an old magnitude is left after this many rows; of a weight, in the average, after this many or AVERAGE_SHARE of all.
MAGNITUDE_ROWS, AVERAGE_ROWS, AVERAGE_SHARE = 20.0, 2000.0, 0.05


@dataclass(frozen=True)
class TexturesConfig:
    """Everything that a run depends on beside the exemplars. batch: B; kimg: thousands of rows; rate: Adam's, which falls along
    a cosine to `final` of itself; exemplars: how many of them, from the first on, 0 for all."""

    generator: GeneratorConfig = field(
        default_factory=lambda: GeneratorConfig(layers=7, channel_base=8192, waves=8, drift=1.5, z=0, texels=128)
    )
    batch: int = 2
    kimg: float = 8.0
    rate: float = 3e-2
    final: float = 0.1
    exemplars: int = 0
    snapshot_kimg: float = 0.5
    seed: int = 0


class Taught(NamedTuple):
    """Rows of a step. patch: which exemplar; feature: its texture, scaled; beta: its geometry parameters. NumPy on the host."""

    patch: Any  # (B,)
    feature: Any  # (B, S, S, C)
    beta: Any  # (B, G)


class TexturesState(NamedTuple):
    """A run under way; a pytree of arrays. a, b: make a texture of what the generator gives (train/natural_start), and stay as
    they are; so do decoder, height: what the exemplars were fitted with, scaled. images: rows seen."""

    generator: Generator
    smooth: Generator
    averages: Averages
    a: Float[Array, "W C"]
    b: Float[Array, "C"]
    adam: optax.OptState
    decoder: Decoder
    height: Float[Array, "R C"]
    step: Int[Array, ""]
    images: Int[Array, ""]


class TexturesReport(NamedTuple):
    """Shares of the variance that are left, and which leaves of the gradient are not finite."""

    error: Scalar
    height: Scalar
    bad: Bool[Array, "_leaves"]


@dataclass(frozen=True, eq=False)
class Scaled:
    """Exemplars scaled to zero mean and unit variance a channel, and the decoder that takes them so. what: as they were read."""

    what: Exemplars
    features: Float[np.ndarray, "K S S C"]
    height: Float[np.ndarray, "R C"]
    decoder: Decoder
    deviation: Float[np.ndarray, "C"]

    @property
    def folder(self) -> Path:
        return self.what.folder

    @property
    def manifest(self) -> dict[str, Any]:
        return self.what.manifest

    @property
    def recipe(self) -> str:
        return self.what.recipe


def fitted(config: TexturesConfig, exemplars: Exemplars) -> tuple[TexturesConfig, Scaled]:
    """The configuration for exemplars, and these scaled. Raises InputError if they have other texels than the generator, or the
    configuration asks for more than there are."""
    count = config.exemplars or len(exemplars.features)
    side = exemplars.features.shape[1]
    if side != config.generator.texels:
        raise InputError(exemplars.path, f"has {side} texels a patch; the generator has {config.generator.texels}")
    if count > len(exemplars.features):
        raise InputError(exemplars.path, f"has {len(exemplars.features)} patches; the experiment asks for {count}")
    if config.batch % min(count, config.batch):
        raise InputError("batch", f"{config.batch} rows do not come evenly from {count} patches")
    some = replace(exemplars, features=exemplars.features[:count], beta=exemplars.beta[:count])
    generator = replace(
        config.generator,
        channels=exemplars.features.shape[3],
        betas=exemplars.beta.shape[1],
        height_rows=len(exemplars.height),
    )
    return replace(config, generator=generator), scaled(some)


def scaled(exemplars: Exemplars) -> Scaled:
    """Exemplars at unit variance a channel."""
    f = exemplars.features.astype(np.float32)
    mean, deviation = f.mean(axis=(0, 1, 2)), np.maximum(f.std(axis=(0, 1, 2)), 1e-6)
    decoder = decoder_of(exemplars.decoder)
    kernel, bias = decoder.trunk[0]
    c = len(mean)
    first = Dense(kernel.at[:c].multiply(deviation[:, None]), bias + jnp.matmul(mean, kernel[:c], precision="highest"))
    decoder = decoder._replace(trunk=[first, *decoder.trunk[1:]])
    height = exemplars.height.astype(np.float32) / deviation
    return Scaled(exemplars, (f - mean) / deviation, height, decoder, deviation)


def feed(config: TexturesConfig, data: Scaled, host: int = 0, hosts: int = 1) -> Callable[[int], Taught]:
    """This host's rows of step i: exemplars in a new order each pass. Raises InputError if hosts cannot share the batch."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    rows, count = config.batch // hosts, len(data.features)

    def at(step: int) -> Taught:
        places = np.arange(step * config.batch, (step + 1) * config.batch)[host * rows : (host + 1) * rows]
        order = {n: np.random.default_rng([config.seed, n]).permutation(count) for n in np.unique(places // count)}
        patch = np.array([order[place // count][place % count] for place in places])
        return Taught(patch.astype(np.int32), data.features[patch], data.what.beta[patch])

    return at


def start(config: TexturesConfig, data: Scaled, key: Key[Array, ""]) -> TexturesState:
    generator, averages, a, b = natural_start(config.generator, jnp.asarray(data.features), key)
    return TexturesState(
        generator,
        jax.tree.map(jnp.copy, generator),
        averages,
        a,
        b,
        _adam(config).init(generator),
        jax.tree.map(jnp.copy, data.decoder),
        jnp.asarray(data.height),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )


def step(
    config: TexturesConfig, state: TexturesState, batch: Taught, across: Across = HERE
) -> tuple[TexturesState, TexturesReport]:
    """One update. Pure."""

    def loss(generator: Generator) -> tuple[Scalar, tuple[Scalar, Scalar, list[Scalar], Array]]:
        w = latents(config, generator, batch.beta)
        phases = own_phases(config, batch.patch)
        side = config.generator.texels
        many = wide(config.generator)
        made = synthesise(many, generator, state.averages, w, phases, jnp.zeros(2, jnp.int32), (side, side))
        feature = jnp.matmul(made.feature, state.a, precision="highest") + state.b
        error = jnp.mean((feature - batch.feature) ** 2)
        profile = synthesise_height(many, generator, w)[..., : batch.feature.shape[3]]
        height = jnp.mean((profile - state.height) ** 2) / jnp.var(state.height)
        return error + height, (error, height, made.magnitude, jnp.mean(w, axis=0))

    (_, seen), gradient = jax.value_and_grad(loss, has_aux=True)(state.generator)
    seen, gradient = across.mean((jax.lax.stop_gradient(seen), gradient))
    error, height, magnitude, w = seen
    with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
        updates, adam = _adam(config).update(gradient, state.adam)
    generator: Any = optax.apply_updates(state.generator, updates)
    rows = batch.patch.shape[0] if across.everyone is None else across.everyone(batch.patch)[0].shape[0]
    images = state.images + rows
    half_life = jnp.minimum(AVERAGE_ROWS, AVERAGE_SHARE * images.astype(error.dtype))
    new = TexturesState(
        generator,
        _towards(state.smooth, generator, 0.5 ** (rows / jnp.maximum(half_life, 1e-8))),
        Averages(_towards(state.averages.magnitude, magnitude, 0.5 ** (rows / MAGNITUDE_ROWS)), w),
        state.a,
        state.b,
        adam,
        state.decoder,
        state.height,
        state.step + 1,
        images,
    )
    return new, TexturesReport(error, height, not_finite(gradient))


def folded(generator: Generator, state: TexturesState) -> Generator:
    """The generator whose last layer does what a and b do after a wide one's."""
    last, product = generator.layers[-1], partial(jnp.matmul, precision="highest")
    bias = product(last.bias, state.a) + state.b / PLANE_SCALE
    tall, c = generator.height[-1], state.a.shape[1]
    return generator._replace(
        layers=[*generator.layers[:-1], last._replace(weight=product(last.weight, state.a), bias=bias)],
        height=[*generator.height[:-1], tall._replace(weight=tall.weight[..., :c], bias=tall.bias[:c])],
    )


def latents(config: TexturesConfig, generator: Generator, beta: Float[Array, "B G"]) -> Float[Array, "B W"]:
    """w of geometry parameters; there is no latent."""
    return map_latent(generator, jnp.zeros((beta.shape[0], config.generator.z), beta.dtype), beta)


def own_phases(config: TexturesConfig, patch: Int[Array, "B"]) -> Phases:
    """The phases of exemplars."""
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(config.seed), k))(patch)
    return phases_of(config, keys)


def phases_of(config: TexturesConfig, keys: Key[Array, "B"]) -> Phases:
    """Phases of a texture for each key."""
    drawn = jax.vmap(lambda k: draw_phases(config.generator, k, 1))(keys)
    return Phases(*jax.tree.map(lambda p: p[:, 0], (drawn.input, drawn.layers)))


def _adam(config: TexturesConfig) -> optax.GradientTransformation:
    steps = max(1, round(config.kimg * 1000 / config.batch))
    return optax.adam(optax.cosine_decay_schedule(config.rate, steps, config.final), 0.9, 0.99)


def _towards(old: Any, new: Any, keep: Any) -> Any:
    return jax.tree.map(lambda o, n: n + (o - n) * jnp.asarray(keep, o.dtype), old, new)
