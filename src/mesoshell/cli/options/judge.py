"""Options of `mesoshell judge`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Blind:
    """Make a blind sheet: real and made pictures from the same cameras, in the same lights, shuffled; and its answers."""

    #: A material's name or .npz file, or the folder of a training run (its newest snapshot).
    material: tyro.conf.Positional[str]
    #: Dataset folder, whose cameras, lights and parameters are used.
    data: Path
    #: Folder to write: sheet.png, which the judge sees, and answers.json, which the judge must not see.
    out: Path
    #: Another material, or run, that counts as real instead of the dataset's renders.
    against: str | None = None
    #: Pictures of each kind.
    count: int = 24
    #: Seed of the choice of renders, of the textures and of the order.
    seed: int = 0


@dataclass(frozen=True)
class Marks:
    """Count how often judges of a blind sheet were right."""

    #: Folder of a blind sheet.
    sheet: tyro.conf.Positional[Path]
    #: Text files, one a judge: r (real) or m (made) for each picture of the sheet, row by row.
    marks: tyro.conf.Positional[tuple[Path, ...]]


@dataclass(frozen=True)
class Scores:
    """Score materials against renders, and renders against other renders; writes scores.json and scores.md."""

    #: Materials' names or .npz files, or folders of training runs (their newest snapshots).
    materials: tyro.conf.Positional[tuple[str, ...]]
    #: Dataset folder; half of it is compared with the other half.
    data: Path
    #: Folder that gets scores.json, scores.md, and pictures of each material's field from above.
    out: Path
    #: Fitted patches that a generator learned from, to find copies of them: materials' names or .npz files.
    exemplars: tuple[str, ...] = ()
    #: Images of each half, at most.
    images: int = 400


@dataclass(frozen=True)
class Options:
    """Judge materials against renders: by blind sheets, and by scores."""

    command: Annotated[Blind | Marks | Scores, tyro.conf.arg(name="")]
