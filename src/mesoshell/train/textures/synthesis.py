"""The generator's textures in a run: at which phases, and what is made of the last layer's output.

Notation
F           texture: A x + b of the generator's output x (train/textures/natural_start)                  (B, S, S, C)
m, v        mean and variance of F a channel, over many textures                                                   (C,)
F/√v − m/√v what a critic is shown, and what a material has, of a run against a critic: exemplars have zero mean and unit
            variance, and a generator whose mean may run off soon makes what the decoder shows as nothing
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.shell.generator.generator import (
    PLANE_SCALE,
    Generator,
    Phases,
    draw_phases,
    map_latent,
    synthesise,
    synthesise_height,
)
from mesoshell.train.textures.natural_start import wide
from mesoshell.train.textures.state import TexturesConfig, TexturesState
from mesoshell.train.update import HERE, Across
from mesoshell.typing import Array, Float, Int, Key, Scalar

#: Added to v; textures that m and v of a material are of.
_EPSILON, _LOOKS = 1e-3, 16


def synthesise_patch(
    config: TexturesConfig,
    state: TexturesState,
    generator: Generator,
    w: Float[Array, "B W"],
    phases: Phases,
    side: int,
) -> tuple[Float[Array, "B S S C"], list[Scalar]]:
    """Textures of so many texels along a side, and mean squares of the layers' inputs."""
    corner = jnp.zeros(2, jnp.int32)
    phases = Phases(*jax.tree.map(lambda p: p.astype(w.dtype), (phases.input, phases.layers)))
    given = synthesise(wide(config.generator), generator, state.averages, w, phases, corner, (side, side))
    return jnp.matmul(given.feature, state.a, precision="highest") + state.b[None, None, None], given.magnitude


def standard(feature: Float[Array, "B S S C"], across: Across = HERE) -> Float[Array, "B S S C"]:
    """Textures less m, over √v, of all of them."""
    m = across.mean(jnp.mean(feature, axis=(0, 1, 2)))[None, None, None]
    v = across.mean(jnp.mean((feature - m) ** 2, axis=(0, 1, 2)))[None, None, None]
    return (feature - m) * jax.lax.rsqrt(v + _EPSILON)


def settle_moments(config: TexturesConfig, state: TexturesState) -> TexturesState:
    """The state with a and b such that its averaged weights make what a critic is shown; unchanged without one."""
    if state.versus is None:
        return state
    some = [_moments(config, state, jax.random.key(20_000 + k)) for k in range(_LOOKS)]
    m, square = (jnp.mean(jnp.stack(x), axis=0) for x in zip(*some, strict=True))
    scale = jax.lax.rsqrt(square - m**2 + _EPSILON)
    return state._replace(a=state.a * scale[None], b=(state.b - m) * scale)


@partial(jax.jit, static_argnums=0)
def _moments(config: TexturesConfig, state: TexturesState, key: Key[Array, ""]) -> tuple[Array, Array]:
    """Mean and mean square, a channel, of one texture."""
    w = latents(config, state.smooth, jax.random.uniform(key, (1, config.generator.betas), jnp.float32))
    f = synthesise_patch(config, state, state.smooth, w, phases_of(config, key[None]), config.window)[0]
    return jnp.mean(f, axis=(0, 1, 2)), jnp.mean(f**2, axis=(0, 1, 2))


def height_error(config: TexturesConfig, state: TexturesState, generator: Generator, w: Float[Array, "B W"]) -> Scalar:
    """Unexplained share of the variance of F(h)."""
    profile = synthesise_height(wide(config.generator), generator, w)[..., : state.height.shape[1]]
    return jnp.mean((profile - state.height[None]) ** 2) / jnp.var(state.height)


def fold(generator: Generator, state: TexturesState) -> Generator:
    """The generator with a and b folded into its last layer."""
    last, product = generator.layers[-1], partial(jnp.matmul, precision="highest")
    bias = product(last.bias, state.a) + state.b / PLANE_SCALE
    tall, c = generator.height[-1], state.a.shape[1]
    return generator._replace(
        layers=[*generator.layers[:-1], last._replace(weight=product(last.weight, state.a), bias=bias)],
        height=[*generator.height[:-1], tall._replace(weight=tall.weight[..., :c], bias=tall.bias[:c])],
    )


def unfold(generator: Generator, state: TexturesState) -> Generator:
    """The inverse of `fold`: a wide generator. Weights of its last layers that folding removes are those of `state`."""
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
