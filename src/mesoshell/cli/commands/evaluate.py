"""The work of `mesoshell evaluate`. Imports JAX, so it is loaded only when it runs."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from mesoshell.atlas.capture import Capture
from mesoshell.atlas.store import read_captured
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.options.evaluate import Options
from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset
from mesoshell.io.patches import Patches
from mesoshell.io.records import read_rows
from mesoshell.io.whole import probe_folder, replace_file
from mesoshell.measure.captured import CHART, LEAST_SIDE, VIEWS, score_views
from mesoshell.measure.distribution import Estimate, fid, kid, with_interval
from mesoshell.measure.features import Extractor, extractor
from mesoshell.measure.queries import QUERIES, score
from mesoshell.train import photographed
from mesoshell.train.atlas import AtlasTraining
from mesoshell.train.method import method_of
from mesoshell.train.parametric import ParametricConfig
from mesoshell.train.record import read_record, snapshots
from mesoshell.train.report import write_report
from mesoshell.train.state import TrainConfig
from mesoshell.train.stream import views_of
from mesoshell.train.surface import SurfaceTraining, held_out
from mesoshell.train.surface_snapshot import painter

_BATCH = 20


def evaluate(options: Options) -> None:
    """All of `mesoshell evaluate`."""
    if options.images < 4 or options.snapshots < 1:
        raise InputError("--images, --snapshots", "must be at least 4 and 1")
    keep_compiled()
    config, data = read_record(options.run)
    found = snapshots(options.run)
    probe_folder(options.run, "RUN")
    method = method_of(config)
    asked = {**data, "folder": options.data or data["folder"]}
    config, dataset = method.fitted(config, method.read(config, asked))
    measures = {SurfaceTraining: _queries, AtlasTraining: _views}
    measure = measures.get(type(config), _pictures)(config, dataset, options)
    chosen = [found[i] for i in sorted(set(np.linspace(len(found) - 1, 0, options.snapshots).round().astype(int)))]
    path = options.run / "evaluation.jsonl"
    rows = read_rows(path, ("name", "images", "kimg"))
    done = {(row["name"], row["images"], row["kimg"]) for row in rows}
    console = Console(stderr=True, highlight=False)
    for images, snapshot in chosen:
        if (measure.names[0], measure.count, images / 1000) in done:
            continue
        with console.status(f"{snapshot.name}: {measure.count} of {measure.what}"):
            scores = measure.of(snapshot)
        for name, estimate in scores.items():
            row = {"name": name, "kimg": images / 1000, "images": measure.count, **estimate._asdict()}
            rows.append(row)
            print(
                f"{row['kimg']:g} kimg: {name} {estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})",
                flush=True,
            )
        ordered = sorted(rows, key=lambda row: (row["name"], row["kimg"]))
        replace_file(path, "".join(json.dumps(row) + "\n" for row in ordered).encode())
    print(write_report(options.run))


class _Measure(NamedTuple):
    """Scores of a snapshot by their names, and of how many of what."""

    names: tuple[str, ...]
    count: int
    what: str
    of: Callable[[Path], dict[str, Estimate]]


def _views(config: AtlasTraining, capture: Capture, options: Options) -> _Measure:
    """Renders of the views that were held out, beside their photographs, and how the surface lies in its texture."""
    tested = photographed.held_out(capture)[1]
    if not tested:
        raise InputError(options.run, "held no view out: it has fewer than 8")
    if min(min(photo.width, photo.height) for photo in capture.photos) < LEAST_SIDE:
        raise InputError(
            options.run, f"has pictures of fewer than {LEAST_SIDE} pixels a side, which SSIM cannot compare"
        )
    names = VIEWS + (() if config.field.colour == "volume" else CHART)
    return _Measure(
        names, len(tested), "held-out views", lambda path: score_views(read_captured(path), capture, config.samples)
    )


def _queries(config: SurfaceTraining, data: Patches, options: Options) -> _Measure:
    """Errors of answers to held-out queries."""
    patches = held_out(data)[1]
    return _Measure(QUERIES, len(patches), "held-out patches", lambda path: score(painter(config, path), patches))


def _pictures(config: TrainConfig | ParametricConfig, dataset: Dataset, options: Options) -> _Measure:
    """Distances of as many pictures to renders."""
    network = extractor(options.inception)
    count = min(options.images, len(dataset.samples))
    positions = np.random.default_rng(0).permutation(len(dataset.samples))[:count]
    real = cache(lambda: network.of(views_of(config, dataset, positions).image))

    def of(snapshot: Path) -> dict[str, Estimate]:
        made = _features(config, snapshot, dataset, positions, network)
        return {name: with_interval(distance, real(), made) for name, distance in zip(names, (kid, fid), strict=True)}

    names = (f"KID-{network.name}", f"FID-{network.name}")
    return _Measure(names, count, "pictures", of)


def _features(
    config: TrainConfig | ParametricConfig, snapshot: Path, dataset: Dataset, positions: np.ndarray, network: Extractor
) -> np.ndarray:
    """Features of a picture for each of these samples: its camera, light and parameters, and geometry of its own."""
    pictures = method_of(config).painter(config, snapshot)
    padded = np.concatenate([positions, positions[: -len(positions) % _BATCH]])
    views = views_of(config, dataset, padded)
    parts = [pictures(type(views)(*(x[i : i + _BATCH] for x in views))) for i in range(0, len(padded), _BATCH)]
    return network.of(np.concatenate(parts)[: len(positions)])
