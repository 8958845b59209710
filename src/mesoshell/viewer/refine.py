"""Refine a picture: few pixels at once, then all of them, pass by pass. What nobody waits for is abandoned within a tile of
rays.

Notation
chessboard  the pixels of one colour of a chessboard. The first picture has rays for these alone, and in the others the mean of
            their neighbours, in two thirds of the time of all rays
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from mesoshell.render.camera import Camera
from mesoshell.render.effects import Effects
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.picture import Rendered
from mesoshell.scene.prepare import prepare
from mesoshell.scene.scene import Scene
from mesoshell.viewer.look import with_size

#: Pixels of the longer side of what is shown first; most samples a pixel.
COARSE, MAX_SAMPLES = 128, 256
#: Samples a ray of what is shown first, 0.8 of a draft's time (docs/how_to/view.md).
FEW = 4


class RefinedPicture(NamedTuple):
    """A picture on its way. rgba: linear, premultiplied; samples: of each pixel that has any; seconds: of the last pass, with
    what came before it; rendered: what the engine gives; camera, settings: that it was made with; whole: whether all pixels
    have samples."""

    rgba: Float[np.ndarray, "H W 4"]
    samples: int
    seconds: float
    rendered: Rendered
    effects: Effects | None
    notes: tuple[str, ...]
    camera: Camera
    settings: Quality
    whole: bool = True


class Abandoned(Exception):
    """Nobody waits for the picture any more."""


def refine(
    scene: Scene,
    quality: str,
    stopped: Callable[[], bool],
    engine: str = "jax",
    coarse: bool = True,
    most: int = MAX_SAMPLES,
    changes: Mapping[str, Any] = MappingProxyType({}),
) -> Iterator[RefinedPicture]:
    """Ever better pictures of a settled scene, up to `most` samples a pixel. quality: a preset's name; coarse: whether a draft
    of few pixels comes first; changes: of the preset's fields. Ends early once `stopped` says so, and raises InputError as
    `prepare` does."""
    assert isinstance(scene.camera, Camera)
    stages = [
        (with_size(scene.camera, COARSE), first_settings(), 1),
        (scene.camera, PRESETS[quality].with_changes(**changes), most),
    ]
    if not coarse or max(scene.camera.width, scene.camera.height) <= COARSE:
        stages = stages[1:]
    try:
        for k, (camera, settings, count) in enumerate(stages):
            half = k < len(stages) - 1
            yield from _passes(replace(scene, camera=camera), settings, count, stopped, engine, half)
    except Abandoned:
        return


def first_settings() -> Quality:
    """Of what is shown first."""
    return PRESETS["draft"].with_changes(samples=FEW)


def _passes(
    scene: Scene, settings: Quality, count: int, stopped: Callable[[], bool], engine: str, half: bool
) -> Iterator[RefinedPicture]:
    """half: of a chessboard's pixels alone."""

    def check(share: float) -> None:
        if stopped():
            raise Abandoned

    assert isinstance(scene.camera, Camera)
    begin = time.perf_counter()
    check(0.0)
    # a grid of density would take seconds at each step of a slider
    ready = prepare(scene, settings.with_changes(density="network"), engine)
    check(0.0)
    passes = ready.passes(None)
    total = np.zeros((*passes.shape, 4))
    known = chessboard(passes.shape) if half and passes.chosen else np.ones(passes.shape, bool)
    for k in range(count):
        total[known] += passes.render(k, np.flatnonzero(known), check)
        image = filled(total / (k + 1), known)
        now = time.perf_counter()
        ended = passes.ended(image, k + 1)
        yield RefinedPicture(
            image, k + 1, now - begin, ended, ready.effects, ready.notes, scene.camera, settings, bool(known.all())
        )
        begin = time.perf_counter()


def chessboard(shape: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """Every other pixel, in turn."""
    y, x = np.indices(shape)
    return (x + y) % 2 == 0


def filled(image: Float[np.ndarray, "H W 4"], known: Bool[np.ndarray, "H W"]) -> Float[np.ndarray, "H W 4"]:
    """A picture whose other pixels are means of the known ones beside them, 0 where there are none."""
    if known.all():
        return image
    given = np.pad(
        np.concatenate([image, np.ones_like(image[..., :1])], axis=2) * known[..., None], ((1, 1), (1, 1), (0, 0))
    )
    around = given[:-2, 1:-1] + given[2:, 1:-1] + given[1:-1, :-2] + given[1:-1, 2:]
    return np.where(known[..., None], image, around[..., :4] / np.maximum(around[..., 4:], 1))
