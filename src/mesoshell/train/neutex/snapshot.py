"""Snapshots of a run of a captured object: the object as a file, and a sheet of pictures.

Notation
sheet        two held-out views (or trained ones if there are none), of each its photograph, a render, and a render with a
             checkerboard texture; beneath them the texture, as a cubemap
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.io.checkout import commit
from mesoshell.neutex.cameras import Photo
from mesoshell.neutex.capture import Capture
from mesoshell.neutex.edit import board_paint, texture_image
from mesoshell.neutex.render import picture, view
from mesoshell.neutex.store import NeuTexModel, read_neutex, write_neutex
from mesoshell.render.quality import Quality
from mesoshell.train.neutex.ray_batches import held_out
from mesoshell.train.neutex.step import NeuTexState, NeuTexTrainConfig


def save(path: Path, config: NeuTexTrainConfig, capture: Capture, state: NeuTexState) -> None:
    """The object as it is now."""
    write_neutex(path, model_of(config, capture, state))


def model_of(config: NeuTexTrainConfig, capture: Capture, state: NeuTexState) -> NeuTexModel:
    """The object that a run has learned so far, with what it was learned from."""
    about = {"config": asdict(config), "capture": capture.manifest, "commit": commit(), "rays": int(state.images)}
    return NeuTexModel(
        config.field,
        state.field,
        capture.centre,
        capture.half,
        capture.photos,
        tuple(held_out(capture)[1]),
        about,
    )


def load_predictor(config: NeuTexTrainConfig, path: Path) -> Callable[[list[Photo]], list[np.ndarray]]:
    """A function that renders a snapshot from cameras: linear premultiplied RGBA."""
    model = read_neutex(path)
    how = view(model.config, model.field, quality_of(config))

    def pictures(photos: list[Photo]) -> list[np.ndarray]:
        return [picture(model.config, model.field, model.to_box(p), how).rgba for p in photos]

    return pictures


def sheet(config: NeuTexTrainConfig, capture: Capture, state: NeuTexState) -> Float[np.ndarray, "h w 3"]:
    """Pictures of the object, linear."""
    now = model_of(config, capture, state)
    how = view(now.config, now.field, quality_of(config))
    chosen = (held_out(capture)[1] or list(range(len(capture.photos))))[:2]
    mapped = now.config.colour != "volume"
    row = []
    for i in chosen:
        photo = now.to_box(capture.photos[i])
        row += [capture.rgb[i], picture(now.config, now.field, photo, how).rgba[..., :3]]
        if mapped:
            row.append(picture(now.config, now.field, photo, how._replace(paint=board_paint())).rgba[..., :3])
    height = min(x.shape[0] for x in row)
    whole = np.concatenate([x[:height] for x in row], axis=1)
    if mapped:
        flat = texture_image(now, "cubemap", max(whole.shape[1] // 3, 1))
        beneath = np.zeros((flat.shape[0], whole.shape[1], 3), np.float32)
        beneath[:, : flat.shape[1]] = flat
        whole = np.concatenate([whole, beneath])
    return np.asarray(np.clip(whole, 0, 1), np.float32)


def quality_of(config: NeuTexTrainConfig) -> Quality:
    """Samples a ray as in training, and one ray a pixel."""
    return Quality(samples=config.samples, pixel_samples=1)
