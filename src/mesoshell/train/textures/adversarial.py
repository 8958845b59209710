"""The generator against a critic: its textures at new phases are told from windows of exemplars.

Notation
y           a critic's view of a texture (critic_view), at unit variance a channel               (B, S, S, I)
x, x̂        logits, a grid of them, of windows of exemplars and of the generator's textures       (B, s, s)
losses      softplus(−(x − x̂)) of the critic, softplus(−(x̂ − x)) of the generator: relativistic, each with a partner
penalty     R1 + R2: |∇_y Σ D|² over the number of logits, of exemplars and of the generator's textures
γ           the critic's loss has γ/2 times the penalty. A critic that leads too far grows γ, one that lags shrinks it:
            ln γ moves by RATE clip((balance − loss)/REACH, ±1) a step
m, v        of the generator's textures, which are shown as (F − m)/√v (synthesis.py)

The losses are those of Huang et al., "The GAN is dead; long live the GAN!" (2024); γ is steered because no fixed one held
(docs/results/generator.md). All rows of a step share m and v; both views of a row are turned alike, and β with them.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax

from mesoshell.shell.generator.generator import Averages, Generator
from mesoshell.shell.generator.texture_critic import Critic, criticise, init_critic
from mesoshell.train.textures.critic_view import draw_light, draw_turn, see, turn_view, turned_angle
from mesoshell.train.textures.exemplars import ExemplarBatch
from mesoshell.train.textures.state import CriticState, TexturesConfig, TexturesReport, TexturesState
from mesoshell.train.textures.synthesis import height_error, latents, phases_of, standard, synthesise_patch
from mesoshell.train.update import Across, apply_gradient, not_finite
from mesoshell.typing import Array, Float, Key, Scalar

RATE, REACH, MIN_GAMMA, MAX_GAMMA = 0.012, 0.2, 0.01, 1000.0
#: Steps in which rates grow to their values; bound of |y| by channel; views of exemplars that define unit variance.
_WARM, _BOUND, _LOOKS = 50, 8.0, 24


@partial(jax.jit, static_argnums=0)
def begun(config: TexturesConfig, state: TexturesState, features: Array, key: Key[Array, ""]) -> CriticState:
    """A critic that has learned nothing."""
    keys = jax.random.split(key, _LOOKS + 1)
    looks = jnp.stack([features[i % len(features)] for i in range(_LOOKS)])
    y = jax.lax.map(lambda x: _critic_view(config, state, *x), (looks, keys[1:]))
    critic = init_critic(config.critic, keys[0])
    gamma, about = jnp.float32(config.gamma), (jnp.mean(y, axis=(0, 1, 2)), jnp.std(y, axis=(0, 1, 2)) + 0.02)
    return CriticState(critic, optimisers(config)[1].init(critic), gamma, *about)


def adversarial_update(
    config: TexturesConfig, state: TexturesState, batch: ExemplarBatch, across: Across
) -> tuple[Generator, optax.OptState, CriticState, Averages, TexturesReport]:
    """Both after an update, the optimiser, magnitudes and mean w of the step, and the report."""
    versus = state.versus
    assert versus
    keys = jax.vmap(lambda k: jax.random.split(jax.random.wrap_key_data(k), 4))(batch.key)
    turns = jax.vmap(draw_turn)(keys[:, 1])
    judge = partial(criticise, beta=_turned_beta(config, batch.beta, turns))

    def shown(feature: Array, at: int) -> Array:
        y = across.each(lambda f, k: _critic_view(config, state, f, k))(feature, keys[:, at])
        y = (y - versus.mean[None, None, None]) / versus.deviation[None, None, None]
        return jax.vmap(turn_view)(_BOUND * jnp.tanh(y / _BOUND), turns)

    real = jax.lax.stop_gradient(shown(batch.feature, 0))
    of_real = judge(versus.critic, real)

    def loss(generator: Generator) -> tuple[Scalar, Any]:
        w = latents(config, generator, batch.beta)
        feature, magnitude = synthesise_patch(config, state, generator, w, phases_of(config, keys[:, 3]), config.window)
        y = shown(standard(feature, across), 2)
        adversarial = jnp.mean(jax.nn.softplus(of_real - judge(versus.critic, y)))
        height = height_error(config, state, generator, w)
        return adversarial + height, ((adversarial, height, Averages(magnitude, jnp.mean(w, axis=0))), y)

    (_, (parts, fake)), gradient = jax.value_and_grad(loss, has_aux=True)(state.generator)
    (adversarial, height, averages), gradient = across.mean((parts, gradient))

    def against(critic: Critic) -> tuple[Scalar, Any]:
        (good, r1), (ill, r2) = (_judged(partial(judge, critic), y) for y in (real, jax.lax.stop_gradient(fake)))
        lost = jnp.mean(jax.nn.softplus(ill - good))
        return lost + versus.gamma / 2 * (r1 + r2), (lost, jnp.mean(good), jnp.mean(ill), r1 + r2)

    (_, (lost, good, ill, penalty)), back = jax.value_and_grad(against, has_aux=True)(versus.critic)
    (lost, good, ill, penalty), back = across.mean(((lost, good, ill, penalty), back))
    for_generator, for_critic = optimisers(config)
    critic, memory = apply_gradient(for_critic, versus.critic, versus.adam, back)
    generator, adam = apply_gradient(for_generator, state.generator, state.adam, gradient)
    lead = jnp.clip((config.balance - lost) / REACH, -1.0, 1.0)
    gamma = jnp.clip(versus.gamma * jnp.exp(RATE * lead), MIN_GAMMA, MAX_GAMMA)
    bad = jnp.concatenate([not_finite(gradient), not_finite(back)])
    none = jnp.zeros_like(adversarial)
    report = TexturesReport(none, height, adversarial, lost, good, ill, penalty, versus.gamma, bad)
    return generator, adam, versus._replace(critic=critic, adam=memory, gamma=gamma), averages, report


def _turned_beta(config: TexturesConfig, beta: Float[Array, "B G"], turns: Array) -> Float[Array, "B G"]:
    """β of textures that are turned: a direction in the plane turns with them."""
    for i in config.directions:
        beta = beta.at[:, i].set(jax.vmap(turned_angle)(beta[:, i], turns))
    return beta


def _judged(judge: Any, y: Float[Array, "B S S I"]) -> tuple[Array, Scalar]:
    """Logits of views, and their part of the penalty."""
    logits, pull = jax.vjp(judge, y)
    (slope,) = pull(jnp.ones_like(logits))
    return logits, jnp.mean(jnp.sum(slope**2, axis=(1, 2, 3))) / (logits.shape[1] * logits.shape[2])


def _critic_view(config: TexturesConfig, state: TexturesState, feature: Array, key: Array) -> Array:
    """y of one texture before it is scaled, with a random light and appearance."""
    k = jax.random.split(key)
    alpha = jax.random.uniform(k[0], (config.alphas,), jnp.float32).astype(feature.dtype)
    light = draw_light(k[1]).astype(feature.dtype)
    return see(state.decoder, config.octaves, feature, state.height, alpha, light)


def optimisers(config: TexturesConfig) -> tuple[optax.GradientTransformation, optax.GradientTransformation]:
    """Of the generator and of the critic."""
    steps = max(4, round(config.kimg * 1000 / config.batch))
    warm, half = min(_WARM, steps // 4), steps // 2

    def adam(rate: float) -> optax.GradientTransformation:
        parts = optax.linear_schedule(0.0, rate, warm), optax.constant_schedule(rate)
        falls = optax.cosine_decay_schedule(rate, steps - half)
        return optax.adam(optax.join_schedules([*parts, falls], [warm, half]), 0.0, 0.99)

    return adam(config.rate), adam(config.critic_rate)
