"""The methods that a run can use, behind one interface.

Notation
method     functions for one type of configuration, which chooses it; all are pure, except `save`
shown      a batch: renders with their labels (generate.ImageBatch), traced queries (surface.QueryBatch), rays of
           patches (patch_rays.Rays), or exemplars (exemplars.ExemplarBatch)
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.exemplars import Exemplars, read_exemplars
from mesoshell.io.query_dataset import Patches, read_patches
from mesoshell.neutex.capture import Capture
from mesoshell.train.fit import feed as fit_feed
from mesoshell.train.fit import snapshot as fit_snapshot
from mesoshell.train.fit import step as fit
from mesoshell.train.fit.patch_rays import FitData, gather_fit_data
from mesoshell.train.gan import snapshot, state, step
from mesoshell.train.gan.curriculum import adapt, renders
from mesoshell.train.gan.state import GanConfig, TrainState
from mesoshell.train.nerf_tex import network as nerf_tex
from mesoshell.train.nerf_tex import snapshot as nerf_tex_snapshot
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.nerf_tex.seeds import adapt as adapt_nerf_tex
from mesoshell.train.neutex import ray_batches
from mesoshell.train.neutex import snapshot as neutex_snapshot
from mesoshell.train.neutex import step as neutex
from mesoshell.train.run_config import RunConfig
from mesoshell.train.surface import snapshot as surface_snapshot
from mesoshell.train.surface import step as surface
from mesoshell.train.textures import exemplars
from mesoshell.train.textures import snapshot as textures_snapshot
from mesoshell.train.textures import state as textures_state
from mesoshell.train.textures import step as textures

#: What runs learn from.
Data = Dataset | Patches | Capture | FitData | Exemplars


class Method(NamedTuple):
    """read: (config, a record's data: `folder`, and what the run was begun with) → the data. adapt: the configuration
    adapted to them, and the data as the method sees them. feed: (config, data, host, hosts) → this host's rows of the batch of
    step i. start: (config, data, key) → state. step: (config, state, shown, across) → (state, report); a report's fields are
    numbers for the log, and `bad`: which leaves of the gradients of `parts` are not finite. parts: what learns, by name.
    together: how many consecutive rows of a batch belong to each other. losses: the report's fields that a console shows. save:
    (path, config, data, state) → a file. sheet: (config, data, state) → a picture. load_predictor: (config, saved file) → a
    function from what is shown to what is scored: pictures, or answers."""

    read: Callable[[Any, dict[str, Any]], Any]
    adapt: Callable[[Any, Any], tuple[Any, Any]]
    feed: Callable[..., Callable[[int], Any]]
    start: Callable[..., Any]
    step: Callable[..., tuple[Any, Any]]
    parts: Callable[[Any], dict[str, Any]]
    together: Callable[[Any], int]
    losses: tuple[str, ...]
    save: Callable[[Path, Any, Any, Any], None]
    sheet: Callable[[Any, Any, Any], np.ndarray]
    load_predictor: Callable[[Any, Path], Callable[[Any], Any]]


def _gan_parts(state: TrainState) -> dict[str, Any]:
    generator, decoder = state.learner
    return {"generator": generator, "decoder": decoder, "discriminator": state.discriminator}


GAN = Method(
    read=lambda config, data: read_dataset(data["folder"]),
    adapt=adapt,
    feed=renders,
    start=lambda config, data, key: state.start(config, key),
    step=step.step,
    parts=_gan_parts,
    together=lambda config: config.views,
    losses=("generator", "discriminator", "r1"),
    save=snapshot.save,
    sheet=snapshot.sheet,
    load_predictor=snapshot.load_predictor,
)
NERF_TEX = Method(
    read=lambda config, data: read_dataset(data["folder"]),
    adapt=adapt_nerf_tex,
    feed=renders,
    start=lambda config, data, key: nerf_tex.start(config, key),
    step=nerf_tex.step,
    parts=lambda state: {"network": state.decoder},
    together=lambda config: 1,
    losses=("radiance", "transmittance"),
    save=nerf_tex_snapshot.save,
    sheet=nerf_tex_snapshot.sheet,
    load_predictor=nerf_tex_snapshot.load_predictor,
)
SURFACE = Method(
    read=lambda config, data: read_patches(data["folder"]),
    adapt=surface.adapt,
    feed=surface.feed,
    start=lambda config, data, key: surface.start(config, key),
    step=surface.step,
    parts=lambda state: {"surface": state.surface},
    together=lambda config: 1,
    losses=("reflectance", "opacity"),
    save=surface_snapshot.save,
    sheet=surface_snapshot.sheet,
    load_predictor=surface_snapshot.load_predictor,
)
ATLAS = Method(
    read=lambda config, data: ray_batches.recorded_capture(data, config.side),
    adapt=neutex.adapt,
    feed=neutex.feed,
    start=lambda config, data, key: neutex.start(config, key),
    step=neutex.step,
    parts=lambda state: {"field": state.field},
    together=lambda config: 1,
    losses=("render", "cycle", "mask", "chamfer", "facing"),
    save=neutex_snapshot.save,
    sheet=neutex_snapshot.sheet,
    load_predictor=neutex_snapshot.load_predictor,
)
FIT = Method(
    read=lambda config, data: gather_fit_data([read_dataset(data["folder"])], config.held),
    adapt=fit_feed.adapt,
    feed=fit_feed.feed,
    start=fit.start,
    step=fit.step,
    parts=lambda state: {"shared": state.common, "textures": state.own.feature},
    together=lambda config: config.together,
    losses=("error",),
    save=fit_snapshot.save,
    sheet=fit_snapshot.sheet,
    load_predictor=fit_snapshot.load_predictor,
)
TEXTURES = Method(
    read=lambda config, data: read_exemplars(data["folder"]),
    adapt=textures_state.adapt,
    feed=exemplars.feed,
    start=textures.start,
    step=textures.step,
    parts=lambda state: {"generator": state.generator} | ({"critic": state.versus.critic} if state.versus else {}),
    together=lambda config: 1,
    losses=("error", "height", "critic"),
    save=textures_snapshot.save,
    sheet=textures_snapshot.sheet,
    load_predictor=textures_snapshot.load_predictor,
)
_OF: dict[type, Method] = {
    GanConfig: GAN,
    NerfTexConfig: NERF_TEX,
    surface.SurfaceTrainConfig: SURFACE,
    neutex.NeuTexTrainConfig: ATLAS,
    fit.FitConfig: FIT,
    textures_state.TexturesConfig: TEXTURES,
}


def method_of(config: RunConfig) -> Method:
    """The method of a configuration."""
    return _OF[type(config)]
