"""Transfer learning: begin a generator's run with the weights of another material's run.

Notation
own         weights that the new run draws for itself, since they depend on a dataset's parameters: the mapping network with
            its mean w, the discriminator's embedding of labels, and the decoder's inputs for appearance
lent        all other weights of learner, weight average and discriminator, and the averages of the layers' magnitudes
anew        the optimisers, and the counts of steps and images: these start from zero

A run on textures has no such parameters. It begins with averaged weights: another run's, or a snapshot's, whose last layer has
a and b folded into it, and is unfolded again. A run on pictures may begin with a snapshot too, of either kind of run, with the
same parameters: generator and decoder are lent, and the discriminator begins anew. Such a run may have more texels a patch, if
its layers are as wide: each keeps its weights for higher frequencies, and what it makes is finer.

Both networks are lent, as by Wang et al., "Transferring GANs: generating images from limited data" (2018).
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.bundle import read_bundle
from mesoshell.io.dataset import Dataset
from mesoshell.nets.mlp import Dense
from mesoshell.shell.generator.model import GeneratorModel, generator_model
from mesoshell.shell.generator.vision_aided import VisionAided
from mesoshell.shell.material.decoder import Decoder
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.export import declared_parameters
from mesoshell.train.gan.state import GanConfig, Learner, TrainState, start
from mesoshell.train.run_config import RunConfig, flat, read_record, snapshots
from mesoshell.train.textures import step as textures
from mesoshell.train.textures import synthesis
from mesoshell.train.textures.exemplars import ScaledExemplars
from mesoshell.train.textures.state import TexturesConfig, TexturesState

#: Fields of a configuration that determine the weights; those of them that follow from a dataset, or change no weight.
WEIGHTS = ("generator.", "discriminator.", "trunk", "head", "picture.octaves")
MAY_DIFFER = ("generator.betas", "discriminator.labels", "generator.precision", "generator.turn", "generator.fourier")
#: What may differ from a snapshot's generator in a run on pictures with more texels a patch.
FINER = ("texels", "channel_base")


def transfer_from(config: RunConfig, data: Any, folder: Path) -> Callable[[Any], Any]:
    """A function that replaces the weights of a run's first state by those of the newest checkpoint in `folder`, which may also
    be a snapshot; for a run on pictures also the folder of a run on textures, whose newest snapshot is taken. Raises InputError
    if it is no generator's run, has no checkpoint, or has other networks, with the fields that differ."""
    if isinstance(config, TexturesConfig) and folder.is_file():
        return _of_snapshot(config, data, folder)
    if isinstance(config, GanConfig) and folder.is_file():
        return _to_pictures(config, data, folder)
    other, begun = read_record(folder)
    if isinstance(config, GanConfig) and isinstance(other, TexturesConfig):
        return _to_pictures(config, data, snapshots(folder)[-1][1])
    if type(config) is not type(other) or not isinstance(config, GanConfig | TexturesConfig):
        raise InputError(folder, "weights can be transferred only between generators' runs of the same method")
    if isinstance(config, TexturesConfig) and begun.get("digest") != data.manifest["digest"]:
        raise InputError(folder, f"was begun with other exemplars than {data.folder}, which scale its weights")
    mine, theirs = flat(asdict(config)), flat(asdict(other))
    may_differ = MAY_DIFFER if isinstance(config, GanConfig) else ()
    if "off" in (mine["generator.fourier"], theirs["generator.fourier"]):  # it has no strengths of maps
        may_differ = tuple(k for k in may_differ if k != "generator.fourier")
    differ = [k for k in mine if k.startswith(WEIGHTS) and k not in may_differ and mine[k] != theirs[k]]
    if differ:
        raise InputError(folder, f"its networks are not this run's: {_differences(mine, theirs, differ)}")
    with Checkpoints(folder / "checkpoints", reading=True) as checkpoints:
        latest = checkpoints.newest(jax.eval_shape(lambda: _started(other, data)))
    if latest is None:
        raise InputError(folder, "has no checkpoint yet")
    old = latest[1]
    if isinstance(config, GanConfig):
        return lambda fresh: transfer_weights(fresh, old, config.appearance)
    _check_scaled(data, old.decoder, folder)
    lent = {"generator": old.smooth, "smooth": jax.tree.map(jnp.copy, old.smooth)}
    return lambda fresh: fresh._replace(averages=old.averages, a=old.a, b=old.b, **lent)


def _to_pictures(config: GanConfig, data: Dataset, path: Path) -> Callable[[TrainState], TrainState]:
    """Generator and decoder of a snapshot, for a run on pictures of the same parameters."""
    bundle = read_bundle(path)
    maker = generator_model(bundle, str(path))
    finer = config.generator.texels > maker.config.texels
    _same_generator(config, maker, path, FINER if finer else ())
    own, shown = declared_parameters(data.manifest), bundle.parameters
    if [(p.name, p.role, p.range) for p in own] != [(p.name, p.role, p.range) for p in shown]:
        names = [", ".join(p.name for p in some) or "none" for some in (shown, own)]
        raise InputError(path, f"its parameters are {names[0]}, those of {data.folder} {names[1]}, or of other ranges")
    fits = jax.eval_shape(lambda: start(config, jax.random.key(0))).learner
    if _shapes(maker.generator) != _shapes(fits.generator):
        differences = _differences(asdict(config.generator), asdict(maker.config), FINER)
        raise InputError(path, f"its generator's layers are not as wide as this run's: {differences}")
    if _shapes(maker.decoder) != _shapes(fits.decoder) or maker.octaves != config.picture.octaves:
        raise InputError(path, "its decoder is not this run's: trunk, head or picture.octaves differ")
    lent = Learner(maker.generator, maker.decoder)
    return lambda fresh: fresh._replace(learner=lent, smooth=jax.tree.map(jnp.copy, lent), averages=maker.averages)


def _shapes(tree: Any) -> list[tuple[int, ...]]:
    return [x.shape for x in jax.tree.leaves(tree)]


def _same_generator(
    config: GanConfig | TexturesConfig, maker: GeneratorModel, path: Path, may_differ: tuple[str, ...] = ()
) -> None:
    """Raise InputError if a snapshot's generator differs from the configuration's in other fields than `may_differ`."""
    mine, theirs = asdict(config.generator), asdict(maker.config)
    differences = _differences(mine, theirs, [k for k in mine if k not in ("precision", "turn", *may_differ)])
    if differences:
        raise InputError(path, f"its generator is not this run's: {differences}")


def _differences(mine: dict[str, Any], theirs: dict[str, Any], names: Iterable[str]) -> str:
    return ", ".join(f"{k} is {theirs[k]}, asked for {mine[k]}" for k in names if mine[k] != theirs[k])


def _check_scaled(data: ScaledExemplars, decoder: Decoder, path: Path) -> None:
    """Raise InputError if a decoder is not the exemplars' as they scale it."""
    taught = zip(jax.tree.leaves(decoder), jax.tree.leaves(data.decoder), strict=True)
    if not all(x.shape == y.shape and np.allclose(x, y, rtol=1e-3, atol=1e-4) for x, y in taught):
        raise InputError(path, f"its decoder is not that of {data.folder}, or was scaled by other exemplars")


def _of_snapshot(config: TexturesConfig, data: ScaledExemplars, path: Path) -> Callable[[TexturesState], TexturesState]:
    """The weights of a snapshot. The exemplars scale its decoder, so comparing decoders tells whether they are the same."""
    maker = generator_model(read_bundle(path), str(path))
    _same_generator(config, maker, path)
    _check_scaled(data, maker.decoder, path)

    def lent(fresh: TexturesState) -> TexturesState:
        generator = synthesis.unfold(maker.generator, fresh)
        return fresh._replace(generator=generator, smooth=jax.tree.map(jnp.copy, generator), averages=maker.averages)

    return lent


def _started(config: Any, data: Any) -> Any:
    key = jax.random.key(config.seed)
    return start(config, key) if isinstance(config, GanConfig) else textures.start(config, data, key)


def transfer_weights(fresh: TrainState, old: TrainState, appearance: int) -> TrainState:
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
        discriminator=_labelled(old.discriminator, fresh.discriminator),
    )


def _labelled(lent: Any, own: Any) -> Any:
    """A discriminator with its own embedding of labels."""
    if isinstance(lent, VisionAided):
        return VisionAided(*map(_labelled, lent, own))
    return lent._replace(embed=own.embed)
