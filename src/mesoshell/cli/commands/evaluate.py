"""`mesoshell evaluate`: score the snapshots of a run. Imports JAX."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.cli.checks import at_least
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.options.evaluate import Options
from mesoshell.cli.progress import say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_folder, replace_file
from mesoshell.io.records import read_rows
from mesoshell.measure.evaluation import FILE, evaluation
from mesoshell.train.gan.discriminators import kind_of
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.method import method_of
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.nerf_tex.seeds import SEED
from mesoshell.train.report import write_report
from mesoshell.train.run_config import RunConfig, flat, read_record, snapshots

FLATTERED = (
    "this run's discriminator judged by EfficientNet-Lite0, so KID-EffLite0 and FID-EffLite0 flatter it: "
    "mesoshell judge scores compares features of Lite2, which nothing here learns from"
)


def run(options: Options) -> None:
    """All of `mesoshell evaluate`."""
    at_least(options, images=4, snapshots=1)
    keep_compiled()
    config, data = read_record(options.run)
    saved = snapshots(options.run)
    probe_folder(options.run, "RUN")
    method = method_of(config)
    source = {**data, "folder": options.data or data["folder"]}
    begun, (config, dataset) = config, method.adapt(config, method.read(config, source))
    _check_parameters(begun, data, config, dataset)
    measure = evaluation(config, dataset, options.run, options.images, options.inception)
    chosen = [saved[i] for i in sorted(set(np.linspace(len(saved) - 1, 0, options.snapshots).round().astype(int)))]
    other = _other(options.data, data["folder"])
    path = options.run / (FILE if other is None else f"evaluation_{other}.jsonl")
    rows = read_rows(path, ("name", "images", "kimg"))
    done = {(row["name"], row["images"], row["kimg"]) for row in rows}
    console = stderr()
    if isinstance(config, GanConfig) and kind_of(config.discriminator).lite0 and options.inception is None:
        say_notes(console, [FLATTERED])
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
    print(write_report(options.run) if other is None else path)


def _check_parameters(begun: RunConfig, data: dict[str, Any], config: RunConfig, dataset: Any) -> None:
    """Raise InputError unless the data vary the parameters that the run was begun with. data: of its record."""
    if not isinstance(config, GanConfig | NerfTexConfig):
        return
    varied = [name for name in dataset.manifest["parameters"] if name != SEED]
    if "fixed_parameters" in data:
        asked = [name for name in data["parameters"] if name not in data["fixed_parameters"]]
    else:  # an old record
        old, new = (
            [flat(asdict(x)).get(k) for k in ("appearance", "generator.betas", "parameters")] for x in (begun, config)
        )
        asked = varied if old == new else ["others"]
    if sorted(asked) != sorted(varied):
        words = [", ".join(names) or "none" for names in (varied, asked)]
        raise InputError(dataset.folder, f"varies the parameters {words[0]}; the run was begun with {words[1]}")


def _other(given: Path | None, own: str) -> str | None:
    """A name for data that are not the run's own, whose report and export do not show their scores; None if they are."""
    if given is None or given.resolve() == Path(own).resolve():
        return None
    return f"{given.resolve().name}_{hashlib.sha256(str(given.resolve()).encode()).hexdigest()[:6]}"
