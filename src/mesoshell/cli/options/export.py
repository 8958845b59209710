"""Options of `mesoshell export`."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Options:
    """Write a run's material, its generator included, as one file that needs nothing beside it."""

    #: Folder of a training run; or a file of exemplars, with --patch.
    run: tyro.conf.Positional[Path]
    #: The file to write.
    out: Path
    #: The snapshot of this many thousand images; the newest if not given.
    kimg: float | None = None
    #: Which patch of exemplars (`mesoshell fit` of many patches), from 0 on.
    patch: int | None = None
