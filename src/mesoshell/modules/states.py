"""A run's state as Flax's train states, and back.

A run's state keeps its own form: a run with two players has two optimisers, and averages beside them, and checkpoints have the
names of its fields. Here each player is a TrainState of the same arrays: `params` is its tree as the state has it, `tx` the
run's optimiser, `apply_fn` its module's `apply`. All else that a step does (R1, averages, frozen parts) stays in the step.
"""

from collections.abc import Callable, Mapping
from functools import partial, reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import optax
from flax.training.train_state import TrainState

from mesoshell.errors import Argument, InputError
from mesoshell.modules.networks import CapturedField, Decoder, Discriminator, Generator, SurfaceMaterial, TextureCritic
from mesoshell.train.gan.state import GanConfig, optimisers
from mesoshell.train.nerf_tex import network as nerf_tex
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.neutex import step as neutex
from mesoshell.train.neutex.step import NeuTexTrainConfig
from mesoshell.train.run_config import RunConfig
from mesoshell.train.surface import step as surface
from mesoshell.train.surface.step import SurfaceTrainConfig
from mesoshell.train.textures import adversarial
from mesoshell.train.textures import step as textures
from mesoshell.train.textures.state import TexturesConfig


class Player(NamedTuple):
    """params, adam: where the state has them, as names of fields; apply: Flax's, of variables whose `params` is that tree."""

    params: tuple[str, ...]
    adam: tuple[str, ...]
    apply: Callable[..., Any]
    tx: optax.GradientTransformation


def train_states(config: RunConfig, state: Any) -> dict[str, TrainState]:
    """The players of a run's state by name. config: as adapted to the data. `apply_fn` of a GAN's `learner` is its
    generator's, on one patch. Raises InputError for a fit of patches, whose step sets the rates, not its optimiser."""
    return {
        name: TrainState(state.step, player.apply, _at(state, player.params), player.tx, _at(state, player.adam))
        for name, player in _players(config, state).items()
    }


def with_train_states(config: RunConfig, state: Any, states: Mapping[str, TrainState]) -> Any:
    """The run's state with those of these players, and their step. Raises InputError as `train_states`."""
    players = _players(config, state)
    for name, mine in states.items():
        state = _put(state, players[name].params, mine.params)
        state = _put(state, players[name].adam, mine.opt_state)._replace(step=mine.step)
    return state


def _players(config: RunConfig, state: Any) -> dict[str, Player]:
    if isinstance(config, GanConfig):
        for_learner, for_discriminator = optimisers(config)
        generator = Generator.of_patch(config.generator)
        judge = Discriminator(config.discriminator, jnp.dtype(config.precision))
        return {
            "learner": Player(("learner",), ("learner_adam",), partial(_of_generator, generator), for_learner),
            "discriminator": Player(("discriminator",), ("discriminator_adam",), judge.apply, for_discriminator),
        }
    if isinstance(config, TexturesConfig):
        generator = Generator.of_patch(config.generator)
        if state.versus is None:
            return {"generator": Player(("generator",), ("adam",), generator.apply, textures.optimiser(config))}
        (tx, for_critic), critic = adversarial.optimisers(config), TextureCritic(config.critic)
        return {
            "generator": Player(("generator",), ("adam",), generator.apply, tx),
            "critic": Player(("versus", "critic"), ("versus", "adam"), critic.apply, for_critic),
        }
    if isinstance(config, SurfaceTrainConfig):
        module, tx = SurfaceMaterial(config.surface), surface.optimiser(config)
        return {"surface": Player(("surface",), ("adam",), module.apply, tx)}
    if isinstance(config, NeuTexTrainConfig):
        return {"field": Player(("field",), ("adam",), CapturedField(config.field).apply, neutex.optimiser(config))}
    if isinstance(config, NerfTexConfig):
        module, tx = Decoder.like(state.decoder), nerf_tex.optimiser(config)
        return {"decoder": Player(("decoder",), ("adam",), module.apply, tx)}
    raise InputError(Argument("config"), "a fit of patches has no train state: its step sets the rates")


def _of_generator(generator: Generator, variables: Mapping[str, Any], *inputs: Any, **keywords: Any) -> Any:
    return generator.apply({**variables, "params": variables["params"].generator}, *inputs, **keywords)


def _at(state: Any, path: tuple[str, ...]) -> Any:
    return reduce(getattr, path, state)


def _put(state: Any, path: tuple[str, ...], value: Any) -> Any:
    first, *rest = path
    return state._replace(**{first: _put(getattr(state, first), tuple(rest), value) if rest else value})
