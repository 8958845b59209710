"""The work of `mesoshell evaluate`. Imports JAX, so it is loaded only when it runs."""

import json
from pathlib import Path

import numpy as np
from rich.console import Console

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.evaluate import Options
from mesoshell.errors import InputError
from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.measure.distribution import fid, kid, with_interval
from mesoshell.measure.features import Extractor, extractor
from mesoshell.train.method import method_of
from mesoshell.train.record import read_record, snapshots
from mesoshell.train.report import write_report
from mesoshell.train.stream import RunConfig, views_of

_BATCH = 20


def evaluate(options: Options) -> None:
    """All of `mesoshell evaluate`."""
    if options.images < 4 or options.snapshots < 1:
        raise InputError("--images, --snapshots", "must be at least 4 and 1")
    keep_compiled()
    config, data = read_record(options.run)
    found = snapshots(options.run)
    config, dataset = method_of(config).fitted(config, read_dataset(options.data or data["folder"]))
    network = extractor(options.inception)
    count = min(options.images, len(dataset.samples))
    positions = np.random.default_rng(0).permutation(len(dataset.samples))[:count]
    chosen = [found[i] for i in sorted(set(np.linspace(len(found) - 1, 0, options.snapshots).round().astype(int)))]
    path = options.run / "evaluation.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(row["name"], row["images"], row["kimg"]) for row in rows}
    console = Console(stderr=True, highlight=False)
    real = None
    for images, snapshot in chosen:
        if (f"KID-{network.name}", count, images / 1000) in done:
            continue
        with console.status(f"{snapshot.name}: {count} pictures"):
            if real is None:
                real = network.of(views_of(config, dataset, positions).image)
            made = _features(config, snapshot, dataset, positions, network)
        for name, distance in (("KID", kid), ("FID", fid)):
            score = with_interval(distance, real, made)
            row = {"name": f"{name}-{network.name}", "kimg": images / 1000, "images": count, **score._asdict()}
            rows.append(row)
            print(
                f"{row['kimg']:g} kimg: {row['name']} {score.value:.4g} ({score.low:.4g} to {score.high:.4g})",
                flush=True,
            )
        ordered = sorted(rows, key=lambda row: (row["name"], row["kimg"]))
        path.write_text("".join(json.dumps(row) + "\n" for row in ordered))
    print(write_report(options.run))


def _features(
    config: RunConfig, snapshot: Path, dataset: Dataset, positions: np.ndarray, network: Extractor
) -> np.ndarray:
    """Features of a picture for each of these samples: its camera, light and parameters, and geometry of its own."""
    pictures = method_of(config).painter(config, snapshot)
    padded = np.concatenate([positions, positions[: -len(positions) % _BATCH]])
    views = views_of(config, dataset, padded)
    parts = [pictures(type(views)(*(x[i : i + _BATCH] for x in views))) for i in range(0, len(padded), _BATCH)]
    return network.of(np.concatenate(parts)[: len(positions)])
