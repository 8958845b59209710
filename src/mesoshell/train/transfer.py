"""Transfer learning: a generator's run that begins with the weights of another run's, whose material is another.

Alphabet
own         what the new run draws for itself: what knows a dataset's parameters. That is the mapping network with its mean w,
            the discriminator's embedding of labels, and the decoder's inputs that are appearance
lent        all other weights of learner, weight average and discriminator, and the averages of the layers' magnitudes
anew        the optimisers, and the counts of steps and images

Both networks are lent, as by Wang et al., "Transferring GANs: generating images from limited data" (2018).
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from mesoshell.errors import InputError
from mesoshell.nets.mlp import Dense
from mesoshell.train import textures
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.record import flat, read_record
from mesoshell.train.state import Learner, TrainConfig, TrainState, start
from mesoshell.train.stream import RunConfig
from mesoshell.train.textures_state import TexturesConfig

#: What of a configuration says what the weights are and mean; and what of that follows from a dataset, or changes no weight.
WEIGHTS = ("generator.", "discriminator.", "trunk", "head", "picture.octaves")
MAY_DIFFER = ("generator.betas", "discriminator.labels", "generator.precision", "generator.turn", "generator.fourier")


def lender(config: RunConfig, data: Any, folder: Path) -> Callable[[Any], Any]:
    """What gives a run's state at the start the weights of the newest checkpoint in `folder`. Raises InputError if that is no
    generator's run, has no checkpoint, or has other networks, with the fields that differ."""
    other, begun = read_record(folder)
    if type(config) is not type(other) or not isinstance(config, TrainConfig | TexturesConfig):
        raise InputError(folder, "weights are lent by a generator's run to a generator's run only, of the same method")
    if isinstance(config, TexturesConfig) and begun.get("digest") != data.manifest["digest"]:
        raise InputError(
            folder, f"was begun with other exemplars than {data.folder}: what it learned is scaled by them"
        )
    mine, theirs = flat(asdict(config)), flat(asdict(other))
    may_differ = MAY_DIFFER if isinstance(config, TrainConfig) else ()
    differ = [k for k in mine if k.startswith(WEIGHTS) and k not in may_differ and mine[k] != theirs[k]]
    if differ:
        said = ", ".join(f"{k} is {theirs[k]}, asked for {mine[k]}" for k in differ)
        raise InputError(folder, f"its networks are not this run's: {said}")
    with Checkpoints(folder / "checkpoints", reading=True) as checkpoints:
        found = checkpoints.newest(jax.eval_shape(lambda: _started(other, data)))
    if found is None:
        raise InputError(folder, "has no checkpoint yet")
    old = found[1]
    if isinstance(config, TrainConfig):
        return lambda fresh: lend(fresh, old, config.appearance)
    lent = {"generator": old.smooth, "smooth": jax.tree.map(jnp.copy, old.smooth)}
    return lambda fresh: fresh._replace(averages=old.averages, a=old.a, b=old.b, **lent)


def _started(config: Any, data: Any) -> Any:
    key = jax.random.key(config.seed)
    return start(config, key) if isinstance(config, TrainConfig) else textures.start(config, data, key)


def lend(fresh: TrainState, old: TrainState, appearance: int) -> TrainState:
    """`fresh` with the weights of `old`. appearance: how many of the last inputs of its decoder are parameters."""

    def learner(own: Learner, lent: Learner) -> Learner:
        kernel, trunk = own.decoder.trunk[0].kernel, lent.decoder.trunk
        inputs = len(kernel) - appearance
        first = Dense(kernel.at[:inputs].set(trunk[0].kernel[:inputs]), trunk[0].bias)
        return Learner(
            lent.generator._replace(mapping=own.generator.mapping), lent.decoder._replace(trunk=[first, *trunk[1:]])
        )

    return fresh._replace(
        learner=learner(fresh.learner, old.learner),
        smooth=learner(fresh.smooth, old.smooth),
        averages=old.averages._replace(w=fresh.averages.w),
        discriminator=old.discriminator._replace(embed=fresh.discriminator.embed),
    )
