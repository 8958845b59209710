"""`mesoshell export`: a run's newest material as a bundle."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from mesoshell.errors import InputError


@dataclass(frozen=True)
class Options:
    """Write a run's material, its generator included, as one file that needs nothing beside it."""

    #: Folder of a training run.
    run: tyro.conf.Positional[Path]
    #: The file to write.
    out: Path
    #: The snapshot of this many thousand images; the newest if not given.
    kimg: float | None = None


def run(options: Annotated[Options, tyro.conf.arg(name="")]) -> None:
    """Write a run's material, its generator included, as one file that needs nothing beside it."""
    import json

    from mesoshell.io.bundle import read_bundle, write_bundle
    from mesoshell.train.record import read_record, snapshots
    from mesoshell.train.state import TrainConfig

    if not isinstance(read_record(options.run)[0], TrainConfig):
        raise InputError(options.run, "holds a network and no generator: it can be evaluated, not exported")
    found = snapshots(options.run)
    kept = [s for s in found if options.kimg is None or abs(s[0] - 1000 * options.kimg) < 1]
    if not kept:
        raise InputError("--kimg", f"there are snapshots at {', '.join(f'{n / 1000:g}' for n, _ in found)}")
    images, path = kept[-1]
    bundle, scores = read_bundle(path), options.run / "evaluation.jsonl"
    rows = [json.loads(line) for line in scores.read_text().splitlines()] if scores.exists() else []
    metrics = {row["name"]: row["value"] for row in rows if row["kimg"] == images / 1000}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bundle(options.out, replace(bundle, provenance=bundle.provenance | {"metrics": metrics}))
    print(f"{options.out}: {images / 1000:g} kimg")
