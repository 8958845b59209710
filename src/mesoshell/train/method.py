"""The ways of learning that a run may go: what it asks of each, as one interface.

Alphabet
method     pure functions of one kind of configuration and state, but for `save`; chosen once, by the configuration's type
shown      a batch of renders with their labels (generate.Shown)
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mesoshell.io.dataset import Dataset
from mesoshell.train import parametric, parametric_snapshot, snapshot, state, step
from mesoshell.train.state import TrainConfig, TrainState
from mesoshell.train.stream import RunConfig, fitted, fitted_parametric


class Method(NamedTuple):
    """fitted: the configuration for a dataset, and the dataset as the method sees it. start: (config, key) → state. step:
    (config, state, shown, across) → (state, report); a report's fields are numbers of the log, and `bad`, which leaves of
    the gradients of `parts` are not finite. parts: what learns, by name. together: neighbours in a batch that belong to each
    other. losses: the report's fields that a console shows. save: (path, config, dataset, state) → a file. sheet: (config,
    dataset, state) → a picture. painter: (config, saved file) → function from shown to as many pictures to be scored."""

    fitted: Callable[[Any, Dataset], tuple[Any, Dataset]]
    start: Callable[..., Any]
    step: Callable[..., tuple[Any, Any]]
    parts: Callable[[Any], dict[str, Any]]
    together: Callable[[Any], int]
    losses: tuple[str, ...]
    save: Callable[[Path, Any, Dataset, Any], None]
    sheet: Callable[[Any, Dataset, Any], np.ndarray]
    painter: Callable[[Any, Path], Callable[[Any], np.ndarray]]


def _gan_parts(state: TrainState) -> dict[str, Any]:
    generator, decoder = state.learner
    return {"generator": generator, "decoder": decoder, "discriminator": state.discriminator}


GAN = Method(
    fitted=lambda config, dataset: (fitted(config, dataset), dataset),
    start=state.start,
    step=step.step,
    parts=_gan_parts,
    together=lambda config: config.views,
    losses=("generator", "discriminator", "r1"),
    save=snapshot.save,
    sheet=snapshot.sheet,
    painter=snapshot.painter,
)
NERF_TEX = Method(
    fitted=fitted_parametric,
    start=parametric.start,
    step=parametric.step,
    parts=lambda state: {"network": state.decoder},
    together=lambda config: 1,
    losses=("radiance", "transmittance"),
    save=parametric_snapshot.save,
    sheet=parametric_snapshot.sheet,
    painter=parametric_snapshot.painter,
)


def method_of(config: RunConfig) -> Method:
    """The method that a configuration is of."""
    return GAN if isinstance(config, TrainConfig) else NERF_TEX
