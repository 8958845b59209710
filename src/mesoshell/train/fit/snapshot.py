"""Snapshots of a fit: its textures with their decoder, and a sheet of held-out pictures beside renders.

sheet    a column a patch: its nearest held-out picture as fitted, over the render, as x / (1 + x)
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.checkout import commit
from mesoshell.io.exemplars import Exemplars, write_exemplars
from mesoshell.io.sheet import tile_pictures
from mesoshell.train.export import declared_parameters, decoder_arrays
from mesoshell.train.fit.holdout import picture_pair
from mesoshell.train.fit.patch_rays import FitData
from mesoshell.train.fit.state import FitConfig, FitState, material_of, texture_of

COLUMNS = 12


def provenance(config: FitConfig, data: FitData, state: FitState) -> dict[str, Any]:
    """Provenance of a fit."""
    return {
        "config": asdict(config),
        "steps": int(state.step),
        "commit": commit(),
        "datasets": [*data.origins],
    }


def exemplars(config: FitConfig, data: FitData, state: FitState, about: dict[str, Any]) -> Exemplars:
    """The fit as exemplars; tiles one by one. about: its provenance."""
    feature = np.asarray(state.own.feature)
    if config.tiles:
        cut = feature.reshape(config.tiles, config.texels, config.tiles, config.texels, -1)
        feature = cut.swapaxes(1, 2).reshape(config.patches, config.texels, config.texels, -1)
    return Exemplars(
        feature,
        np.asarray(state.common.height)[:, 0],
        data.beta,
        decoder_arrays(state.common.decoder),
        config.octaves,
        declared_parameters(data.manifest),
        about,
    )


def save(path: Path, config: FitConfig, data: FitData, state: FitState) -> None:
    """Write a state as exemplars."""
    write_exemplars(path, exemplars(config, data, state, provenance(config, data, state)))


def sheet(config: FitConfig, data: FitData, state: FitState) -> Float[np.ndarray, "h w 3"]:
    """A sheet of up to COLUMNS patches, by pictures of their largest common size; trained ones where none are held out."""
    patches = np.unique(np.linspace(0, config.patches - 1, COLUMNS).round().astype(int))
    pixels = [data.held[k] if len(data.held[k]) else data.learned[k] for k in patches]
    pictures = [np.unique(np.searchsorted(data.first, p, side="right") - 1) for p in pixels]
    size = min(max(data.samples[i].size for i in n) for n in pictures)
    pairs = []
    for k, n in zip(patches, pictures, strict=True):
        fit = [i for i in n if data.samples[i].size == size] or list(n)
        nearest = min(fit, key=lambda i: data.samples[i].radius)
        pairs.append(
            picture_pair(
                config, data, material_of(state.common, texture_of(config, state, int(k))), int(k), int(nearest)
            )
        )
    pairs = [pair for pair in pairs if pair[0].shape == pairs[0][0].shape]
    shown = np.stack([np.stack(side) for side in zip(*pairs, strict=True)]).reshape(-1, *pairs[0][0].shape)
    return np.asarray(tile_pictures(shown[..., :3], len(pairs)))


def load_predictor(config: FitConfig, path: Path) -> Callable[[Any], Any]:
    """Raise InputError: a fit scores its own held-out pictures."""
    raise InputError(path, "is of a fit, which scores its held-out pictures itself")
