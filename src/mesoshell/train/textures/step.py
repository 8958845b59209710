"""The generator learns fitted textures, with the decoder of their fit, without tracing a ray.

Notation
K, B        exemplars (train/textures/exemplars), each with its own phases, drawn once; rows a step
F̂, F        the generator's texture at an exemplar's phases and β; the exemplar's texture         (B, S, S, C)
error       mean of (F̂ − F)²: the unexplained share of the variance, as exemplars have unit variance a channel
height      the same for F(h), which all exemplars share

Regression teaches the generator its exemplars, at their phases; how well it generalises to other phases depends on their
number. With `adversarial` a critic teaches in its place (train/textures/adversarial): neither is in the program of the other.
"""

from typing import Any

import jax
import jax.numpy as jnp
import optax

from mesoshell.shell.generator.generator import Averages, Generator
from mesoshell.train.textures import adversarial
from mesoshell.train.textures.exemplars import ExemplarBatch, ScaledExemplars
from mesoshell.train.textures.natural_start import natural_start
from mesoshell.train.textures.state import TexturesConfig, TexturesReport, TexturesState
from mesoshell.train.textures.synthesis import height_error, latents, own_phases, synthesise_patch
from mesoshell.train.update import HERE, Across, apply_gradient, not_finite
from mesoshell.typing import Array, Key, Scalar

#: Half-lives, rows: of the average magnitude; of the average weights, or AVERAGE_SHARE of the rows seen if that is less.
MAGNITUDE_ROWS, AVERAGE_ROWS, AVERAGE_SHARE = 20.0, 2000.0, 0.05


def start(config: TexturesConfig, data: ScaledExemplars, key: Key[Array, ""]) -> TexturesState:
    """A state before training, begun as exemplars are (natural_start)."""
    k = jax.random.split(key)
    features = jnp.asarray(data.features)
    natural = natural_start(config.generator, features, k[0])
    state = TexturesState(
        natural.generator,
        jax.tree.map(jnp.copy, natural.generator),
        natural.averages,
        natural.a,
        natural.b,
        adversarial.optimisers(config)[0].init(natural.generator)
        if config.adversarial
        else optimiser(config).init(natural.generator),
        jax.tree.map(jnp.copy, data.decoder),
        jnp.asarray(data.height),
        None,
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )
    return state._replace(versus=adversarial.begun(config, state, features, k[1])) if config.adversarial else state


def step(
    config: TexturesConfig, state: TexturesState, batch: ExemplarBatch, across: Across = HERE
) -> tuple[TexturesState, TexturesReport]:
    """One update of the generator, and of the critic if there is one. Pure."""
    if config.adversarial:
        generator, adam, versus, averages, report = adversarial.adversarial_update(config, state, batch, across)
    else:
        versus = None
        generator, adam, averages, report = _regressed(config, state, batch, across)
    rows = across.rows(batch.patch)
    images = state.images + rows
    half_life = jnp.minimum(AVERAGE_ROWS, AVERAGE_SHARE * images.astype(report.height.dtype))
    new = state._replace(
        generator=generator,
        smooth=_towards(state.smooth, generator, 0.5 ** (rows / jnp.maximum(half_life, 1e-8))),
        averages=averages._replace(
            magnitude=_towards(state.averages.magnitude, averages.magnitude, 0.5 ** (rows / MAGNITUDE_ROWS))
        ),
        adam=adam,
        versus=versus,
        step=state.step + 1,
        images=images,
    )
    return new, report


def _regressed(
    config: TexturesConfig, state: TexturesState, batch: ExemplarBatch, across: Across
) -> tuple[Generator, optax.OptState, Averages, TexturesReport]:
    """The generator after an update, its optimiser, magnitudes and mean w of the step, and the report."""

    def loss(generator: Generator) -> tuple[Scalar, Any]:
        w = latents(config, generator, batch.beta)
        feature, magnitude = synthesise_patch(
            config, state, generator, w, own_phases(config, batch.patch), config.generator.texels
        )
        error = jnp.mean((feature - batch.feature) ** 2)
        height = height_error(config, state, generator, w)
        return error + height, (error, height, Averages(magnitude, jnp.mean(w, axis=0)))

    (_, parts), gradient = jax.value_and_grad(loss, has_aux=True)(state.generator)
    (error, height, averages), gradient = across.mean((parts, gradient))
    generator, adam = apply_gradient(optimiser(config), state.generator, state.adam, gradient)
    none = jnp.zeros((), error.dtype)
    return (
        generator,
        adam,
        averages,
        TexturesReport(error, height, none, none, none, none, none, none, not_finite(gradient)),
    )


def optimiser(config: TexturesConfig) -> optax.GradientTransformation:
    """Of regression."""
    steps = max(1, round(config.kimg * 1000 / config.batch))
    return optax.adam(optax.cosine_decay_schedule(config.rate, steps, config.final), 0.9, 0.99)


def _towards(old: Any, new: Any, keep: Any) -> Any:
    return jax.tree.map(lambda o, n: n + (o - n) * jnp.asarray(keep, o.dtype), old, new)
