"""Options of `mesoshell fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Options:
    """Fit patches to datasets that show them; a call that is repeated goes on from the run folder."""

    #: Dataset folders, as `mesoshell dataset render` with --patch 0, --patches 16 or --tiles writes them; several are learnt
    #: together.
    datasets: tyro.conf.Positional[tuple[Path, ...]]
    #: The file to write: a material of one patch or of corner tiles; or exemplars of many (for `mesoshell train`, or `mesoshell
    #: export --patch`).
    out: Path = Path("out/material.npz")
    #: Folder of checkpoints and log; if it holds some, the fit goes on from there.
    run: Path = Path("runs/fit")
    #: Held-out datasets to score the result on; may be repeated.
    test: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    #: Images of each patch, the last ones, that are held out to score the result on.
    held: int = 0
    #: Material (bundled, or a file) or exemplars whose decoder is kept fixed; only textures are fitted.
    decoder: str | None = None
    #: Steps in all.
    steps: int = 4000
    #: Rays a step, split into rows of one patch each: one row for every 512 rays of a multiple of 4096, else 8, or 1
    #: where 8 does not divide them.
    rays: int = 2048
    #: Texels a patch of the feature textures; a power of two.
    texels: int = 256
    #: Width of the decoder's layers.
    width: int = 64
    #: Seed of initialisation and order.
    seed: int = 0
