"""The generator learns fitted textures, with the decoder of their fit, without tracing a ray.

Notation
K, B        exemplars (train/textures/exemplars), each with its own phases, drawn once; rows a step
F̂, F        the generator's texture at an exemplar's phases and β; the exemplar's texture         (B, S, S, C)
error       mean of (F̂ − F)²: the unexplained share of the variance, as exemplars have unit variance a channel
height      the same for F(h), which all exemplars share
y           the critic's view of a texture (train/textures/critic_view), at unit variance a channel               (B, S, S, I)
D           the critic's logits, a grid of them (shell/generator/texture_critic)

Regression alone teaches the generator its exemplars, at their phases; how well it generalises to other phases depends on their
number. With `adversarial` above 0 a critic compares textures of new phases with shifted exemplars, and the regression stays as
an anchor (docs/concepts/generator.md). At 0 there is no critic in the program.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mesoshell.shell.generator.generator import (
    PLANE_SCALE,
    Averages,
    Generator,
    Phases,
    draw_phases,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.shell.generator.texture_critic import Critic, criticise, init_critic
from mesoshell.train.textures.critic_view import draw_light, see, turned
from mesoshell.train.textures.exemplars import ExemplarBatch, ScaledExemplars
from mesoshell.train.textures.natural_start import natural_start, wide
from mesoshell.train.textures.state import CriticReport, CriticState, TexturesConfig, TexturesReport, TexturesState
from mesoshell.train.update import HERE, Across, not_finite, updated
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

#: Half-lives, rows: of the average magnitude; of the average weights, or AVERAGE_SHARE of the rows seen if that is less.
MAGNITUDE_ROWS, AVERAGE_ROWS, AVERAGE_SHARE = 20.0, 2000.0, 0.05
#: ε; bound of |y| by channel; views of exemplars that define unit variance.
_NOISE, _MOST, _LOOKS = 0.1, 4.0, 12


def start(config: TexturesConfig, data: ScaledExemplars, key: Key[Array, ""]) -> TexturesState:
    k = jax.random.split(key)
    features = jnp.asarray(data.features)
    natural = natural_start(config.generator, features, k[0])
    state = TexturesState(
        natural.generator,
        jax.tree.map(jnp.copy, natural.generator),
        natural.averages,
        natural.a,
        natural.b,
        optimiser(config, config.rate).init(natural.generator),
        jax.tree.map(jnp.copy, data.decoder),
        jnp.asarray(data.height),
        None,
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )
    return state._replace(versus=_versus(config, state, features, k[1])) if config.adversarial else state


def _versus(config: TexturesConfig, state: TexturesState, features: Array, key: Key[Array, ""]) -> CriticState:
    keys = jax.random.split(key, _LOOKS + 1)
    looks = jnp.stack([features[i % len(features)] for i in range(_LOOKS)])
    y = jax.jit(lambda f, k: jax.lax.map(lambda x: _seen(config, state, *x), (f, k)))(looks, keys[1:])
    critic = init_critic(config.critic, keys[0])
    memory = optimiser(config, config.critic_rate).init(critic)
    return CriticState(critic, memory, jnp.mean(y, axis=(0, 1, 2)), jnp.std(y, axis=(0, 1, 2)) + 0.02)


def step(
    config: TexturesConfig, state: TexturesState, batch: ExemplarBatch, across: Across = HERE
) -> tuple[TexturesState, TexturesReport]:
    """One update of the generator, and of the critic if there is one. Pure."""
    versus, zero = state.versus, jnp.zeros((), state.a.dtype)
    keys = jax.vmap(lambda k: jax.random.split(jax.random.wrap_key_data(k), 6))(batch.key)

    def shown(feature: Array, at: int) -> Array:
        assert versus
        y = across.each(lambda f, k: _seen(config, state, f, k))(feature, keys[:, at])
        y = jnp.clip((y - versus.mean[None, None, None]) / versus.deviation[None, None, None], -_MOST, _MOST)
        return y if config.generator.betas else jax.vmap(turned)(y, keys[:, at + 1])

    def loss(generator: Generator) -> tuple[Scalar, Any]:
        w = latents(config, generator, batch.beta)
        feature, magnitude = made(config, state, generator, w, own_phases(config, batch.patch))
        error = jnp.mean((feature - batch.feature) ** 2)
        profile = synthesise_height(wide(config.generator), generator, w)[..., : batch.feature.shape[3]]
        height = jnp.mean((profile - state.height[None]) ** 2) / jnp.var(state.height)
        total, told, y = config.anchor * error + height, zero, None
        if versus:
            w_new = latents(config, generator, batch.other_beta)
            new, _ = made(config, state, generator, w_new, phases_of(config, keys[:, 0]))
            y = shown(new, 1)
            told = jnp.mean(jax.nn.softplus(-criticise(versus.critic, y, batch.other_beta, across.everyone)))
            total += config.adversarial * told
        return total, (error, height, told, magnitude, jnp.mean(w, axis=0), y)

    (_, (*said, y)), gradient = jax.value_and_grad(loss, has_aux=True)(state.generator)
    said, gradient = across.mean((jax.lax.stop_gradient(said), gradient))
    error, height, told, magnitude, w = said
    bad, heard = [not_finite(gradient)], CriticReport(zero, zero, zero, zero)
    if versus:
        real = jax.lax.stop_gradient(shown(batch.other, 3))
        versus, heard, worse = _judged(config, versus, real, jax.lax.stop_gradient(y), batch.other_beta, keys, across)
        bad.append(worse)
    learner = updated(optimiser(config, config.rate), state.generator, state.adam, gradient)
    if versus:  # Adam's count waits too, else its first steps would be several times too large
        waits = state.step < config.warm
        learner = jax.tree.map(lambda old, new: jnp.where(waits, old, new), (state.generator, state.adam), learner)
    generator, adam = learner
    rows = across.rows(batch.patch)
    images = state.images + rows
    half_life = jnp.minimum(AVERAGE_ROWS, AVERAGE_SHARE * images.astype(error.dtype))
    new = state._replace(
        generator=generator,
        smooth=_towards(state.smooth, generator, 0.5 ** (rows / jnp.maximum(half_life, 1e-8))),
        averages=Averages(_towards(state.averages.magnitude, magnitude, 0.5 ** (rows / MAGNITUDE_ROWS)), w),
        adam=adam,
        versus=versus,
        step=state.step + 1,
        images=images,
    )
    return new, TexturesReport(
        error, height, told, heard.critic, heard.real, heard.fake, heard.penalty, jnp.concatenate(bad)
    )


def _judged(
    config: TexturesConfig, versus: CriticState, real: Array, fake: Array, beta: Array, keys: Array, across: Across
) -> tuple[CriticState, CriticReport, Bool[Array, "_leaves"]]:
    """The critic after an update, its report, and which leaves of its gradient are not finite."""
    noise = jax.vmap(lambda k: jax.random.normal(k, (2, *real.shape[1:]), jnp.float32))(keys[:, 5]).astype(real.dtype)

    def loss(critic: Critic) -> tuple[Scalar, CriticReport]:
        judge = partial(criticise, critic, beta=beta, everyone=across.everyone)
        good, ill = judge(real), judge(fake)
        moved = (judge(y + _NOISE * noise[:, i]) for i, y in enumerate((real, fake)))
        apart = [jnp.mean((m - d) ** 2) for m, d in zip(moved, (good, ill), strict=True)]
        penalty = (apart[0] + apart[1]) / _NOISE**2
        told = jnp.mean(jax.nn.softplus(-good)) + jnp.mean(jax.nn.softplus(ill))
        return told + config.gamma / 2 * penalty, CriticReport(told, jnp.mean(good), jnp.mean(ill), penalty)

    (_, heard), gradient = jax.value_and_grad(loss, has_aux=True)(versus.critic)
    heard, gradient = across.mean((heard, gradient))
    critic, adam = updated(optimiser(config, config.critic_rate), versus.critic, versus.adam, gradient)
    return versus._replace(critic=critic, adam=adam), heard, not_finite(gradient)


def _seen(config: TexturesConfig, state: TexturesState, feature: Array, key: Array) -> Array:
    """y of one texture before it is scaled, with a random light and appearance."""
    k = jax.random.split(key)
    alpha = jax.random.uniform(k[0], (config.alphas,), jnp.float32).astype(feature.dtype)
    light = draw_light(k[1]).astype(feature.dtype)
    return see(state.decoder, config.octaves, feature, state.height, alpha, light)


def made(
    config: TexturesConfig, state: TexturesState, generator: Generator, w: Float[Array, "B W"], phases: Phases
) -> tuple[Float[Array, "B S S C"], list[Scalar]]:
    """Textures of a patch's side, and mean squares of the layers' inputs."""
    side, corner = config.generator.texels, jnp.zeros(2, jnp.int32)
    phases = Phases(*jax.tree.map(lambda p: p.astype(w.dtype), (phases.input, phases.layers)))
    given = synthesise(wide(config.generator), generator, state.averages, w, phases, corner, (side, side))
    return jnp.matmul(given.feature, state.a, precision="highest") + state.b[None, None, None], given.magnitude


def folded(generator: Generator, state: TexturesState) -> Generator:
    """The generator with a and b folded into its last layer."""
    last, product = generator.layers[-1], partial(jnp.matmul, precision="highest")
    bias = product(last.bias, state.a) + state.b / PLANE_SCALE
    tall, c = generator.height[-1], state.a.shape[1]
    return generator._replace(
        layers=[*generator.layers[:-1], last._replace(weight=product(last.weight, state.a), bias=bias)],
        height=[*generator.height[:-1], tall._replace(weight=tall.weight[..., :c], bias=tall.bias[:c])],
    )


def unfolded(generator: Generator, state: TexturesState) -> Generator:
    """The inverse of `folded`: a wide generator. Weights of its last layers that folding removes are those of `state`."""
    last, tall, product = generator.layers[-1], generator.height[-1], partial(jnp.matmul, precision="highest")
    back, c = jnp.asarray(np.linalg.pinv(np.asarray(state.a))), state.a.shape[1]
    wider = last._replace(weight=product(last.weight, back), bias=product(last.bias - state.b / PLANE_SCALE, back))
    own = state.generator.height[-1]
    higher = tall._replace(weight=own.weight.at[..., :c].set(tall.weight), bias=own.bias.at[:c].set(tall.bias))
    return generator._replace(layers=[*generator.layers[:-1], wider], height=[*generator.height[:-1], higher])


def latents(config: TexturesConfig, generator: Generator, beta: Float[Array, "B G"]) -> Float[Array, "B W"]:
    """w of geometry parameters; z is zero."""
    return map_latent(generator, jnp.zeros((beta.shape[0], config.generator.z), beta.dtype), beta)


def own_phases(config: TexturesConfig, patch: Int[Array, "B"]) -> Phases:
    """The phases of exemplars."""
    return phases_of(config, jax.vmap(lambda k: jax.random.fold_in(jax.random.key(config.seed), k))(patch))


def phases_of(config: TexturesConfig, keys: Key[Array, "B"]) -> Phases:
    """Phases of a texture for each key."""
    drawn = jax.vmap(lambda k: draw_phases(config.generator, k, 1))(keys)
    return Phases(*jax.tree.map(lambda p: p[:, 0], (drawn.input, drawn.layers)))


def optimiser(config: TexturesConfig, rate: float) -> optax.GradientTransformation:
    steps = max(1, round(config.kimg * 1000 / config.batch))
    return optax.adam(optax.cosine_decay_schedule(rate, steps, config.final), 0.0 if config.adversarial else 0.9, 0.99)


def _towards(old: Any, new: Any, keep: Any) -> Any:
    return jax.tree.map(lambda o, n: n + (o - n) * jnp.asarray(keep, o.dtype), old, new)
