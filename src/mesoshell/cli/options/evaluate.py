"""`mesoshell evaluate`: how near a run's pictures are to its renders."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Options:
    """Score a run's snapshots by KID and FID; writes RUN/evaluation.jsonl and RUN/report.html."""

    #: Folder of a training run.
    run: tyro.conf.Positional[Path]
    #: Packed dataset to compare with; the run's own if not given.
    data: Path | None = None
    #: Renders, and as many generated pictures, that are compared; at most all of the dataset's.
    images: int = 500
    #: Snapshots to score, evenly spaced up to the newest; those scored before with as many images are not scored again.
    snapshots: int = 6
    #: Weights of Inception v3 (a PyTorch state dict), for the field's usual features in place of EfficientNet-Lite0's.
    inception: Path | None = None
