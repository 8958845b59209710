"""`mesoshell fit`: one material from renders of one fixed slab."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Options:
    """Fit a material to datasets of one fixed slab; writes a bundle, and a run folder that a later call goes on from."""

    #: Dataset folders (as `mesoshell dataset render` writes them); several are learnt together.
    datasets: tyro.conf.Positional[tuple[Path, ...]]
    #: The bundle to write.
    out: Path = Path("out/material.npz")
    #: Folder of checkpoints and log; if it holds some, the fit goes on from there.
    run: Path = Path("runs/fit")
    #: Held-out datasets to score the result on; may be repeated.
    test: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    #: Steps in all.
    steps: int = 4000
    #: Rays a step.
    rays: int = 2048
    #: Texels a patch of the feature texture; a power of two.
    texels: int = 256
    #: Width of the decoder's layers.
    width: int = 64
    #: Seed of initialisation and order.
    seed: int = 0


def run(options: Annotated[Options, tyro.conf.arg(name="")]) -> None:
    """Fit a material to datasets of one fixed slab; writes a bundle, and a run folder that a later call goes on from."""
    from mesoshell.train.parallel import split_cpu

    split_cpu()
    from mesoshell.cli import fitting

    fitting.fit_to_bundle(options)
