"""How snapshots are scored, by the kind of run; and scores in the provenance of what is exported."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.io.query_dataset import Patches
from mesoshell.io.records import read_rows
from mesoshell.measure.captured import CHART, MIN_SIDE, VIEWS, score_views
from mesoshell.measure.distribution import Estimate, fid, kid, with_interval
from mesoshell.measure.features import Extractor, extractor
from mesoshell.measure.queries import QUERIES, score
from mesoshell.neutex.capture import Capture
from mesoshell.neutex.store import read_neutex
from mesoshell.train.gan.curriculum import views_of
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.method import method_of
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.neutex import ray_batches
from mesoshell.train.neutex.step import NeuTexTrainConfig
from mesoshell.train.run_config import RunConfig
from mesoshell.train.surface.snapshot import load_predictor
from mesoshell.train.surface.step import SurfaceTrainConfig, held_out

#: In a run's folder: a score of a snapshot a line, with `name`, `kimg`, `images`, `value`, `low` and `high`.
FILE = "evaluation.jsonl"
#: Fewest pictures that distances are estimated from.
FEWEST = 4
_BATCH = 20


class Evaluation(NamedTuple):
    """of: from a snapshot's file to scores by their `names`; they compare `count` of `what`, such as pictures."""

    names: tuple[str, ...]
    count: int
    what: str
    of: Callable[[Path], dict[str, Estimate]]


def evaluation(config: RunConfig, data: Any, run: Path, images: int, weights: Path | None = None) -> Evaluation:
    """How snapshots of a run are scored. images: pictures to compare, at most; weights: of Inception v3, for its features
    instead of EfficientNet-Lite0's. Raises InputError for a run that cannot be scored, or unusable weights."""
    if isinstance(config, NeuTexTrainConfig):
        return _views(config, data, run)
    if isinstance(config, SurfaceTrainConfig):
        return _queries(config, data)
    if isinstance(config, GanConfig | NerfTexConfig):
        return _pictures(config, data, images, weights)
    raise InputError(run, "cannot be evaluated: its snapshots make no pictures to compare with renders")


def with_scores(bundle: Any, run: Path, images: int) -> Any:
    """The bundle with the scores of the run's snapshot of `images` images in its provenance, if there are any."""
    rows = read_rows(run / FILE, ("name", "value", "kimg"))
    metrics = {row["name"]: row["value"] for row in rows if row["kimg"] == images / 1000}
    return replace(bundle, provenance=bundle.provenance | {"metrics": metrics})


def _views(config: NeuTexTrainConfig, capture: Capture, run: Path) -> Evaluation:
    """Renders of held-out views against their photographs, and distortion of the texture."""
    tested = ray_batches.held_out(capture)[1]
    if not tested:
        raise InputError(run, "has no photographs held out: there are fewer than 8")
    if min(min(photo.width, photo.height) for photo in capture.photos) < MIN_SIDE:
        raise InputError(run, f"has pictures of fewer than {MIN_SIDE} pixels a side, which SSIM cannot compare")
    names = VIEWS + (() if config.field.colour == "volume" else CHART)
    scores = lambda path: score_views(read_neutex(path), capture, config.samples)  # noqa: E731
    return Evaluation(names, len(tested), "held-out views", scores)


def _queries(config: SurfaceTrainConfig, data: Patches) -> Evaluation:
    """Errors of answers to held-out queries."""
    patches = held_out(data)[1]
    return Evaluation(
        QUERIES, len(patches), "held-out patches", lambda path: score(load_predictor(config, path), patches)
    )


def _pictures(config: GanConfig | NerfTexConfig, dataset: Dataset, images: int, weights: Path | None) -> Evaluation:
    """KID and FID of generated pictures against as many renders."""
    network = extractor(weights)
    count = min(images, len(dataset.samples))
    if count < FEWEST:
        raise InputError(dataset.folder, f"has {count} images: at least {FEWEST} are compared")
    positions = np.random.default_rng(0).permutation(len(dataset.samples))[:count]
    real = cache(lambda: network.of(views_of(config, dataset, positions).image))

    def of(snapshot: Path) -> dict[str, Estimate]:
        made = _features(config, snapshot, dataset, positions, network)
        return {name: with_interval(distance, real(), made) for name, distance in zip(names, (kid, fid), strict=True)}

    names = (f"KID-{network.name}", f"FID-{network.name}")
    return Evaluation(names, count, "pictures", of)


def _features(
    config: GanConfig | NerfTexConfig, snapshot: Path, dataset: Dataset, positions: np.ndarray, network: Extractor
) -> np.ndarray:
    """Features of a picture for each of these samples, with its camera, light and parameters, but another geometry."""
    pictures = method_of(config).load_predictor(config, snapshot)
    padded = np.concatenate([positions, positions[: -len(positions) % _BATCH]])
    views = views_of(config, dataset, padded)
    parts = [pictures(type(views)(*(x[i : i + _BATCH] for x in views))) for i in range(0, len(padded), _BATCH)]
    made = np.concatenate(parts)[: len(positions)]
    if not np.isfinite(made).all():
        raise InputError(snapshot, "makes pictures with NaN or infinite values")
    return network.of(made)
