"""Options of `mesoshell evaluate`."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Options:
    """Score a run's snapshots by KID and FID; writes RUN/evaluation.jsonl and RUN/report.html, or for --data in another
    folder RUN/evaluation_FOLDER_HASH.jsonl."""

    #: Folder of a training run.
    run: tyro.conf.Positional[Path]
    #: Packed dataset to compare with; the run's own if not given.
    data: Path | None = None
    #: Number of renders, and of generated pictures, to compare; at most as many as the dataset has.
    images: int = 500
    #: Snapshots to score, evenly spaced up to the newest; those scored before with as many images are not scored again.
    snapshots: int = 6
    #: Weights of Inception v3 (a PyTorch state dict): compare its features, the usual ones, instead of EfficientNet-Lite0's.
    inception: Path | None = None
