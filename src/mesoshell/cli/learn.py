"""A training run with a bar: what every verb that learns calls. Imports JAX."""

import sys
from pathlib import Path
from typing import Any, Literal

from mesoshell.cli.host_process import LOST, SAID_LOST
from mesoshell.cli.progress import bar, stderr
from mesoshell.io.atomic import probe_folder
from mesoshell.train.hosts import HostLost, is_first
from mesoshell.train.malloc import keep_memory
from mesoshell.train.method import Data, method_of
from mesoshell.train.run import Diverged, train
from mesoshell.train.run_config import RunConfig


def learn(
    config: RunConfig, dataset: Data, run: Path, how: Literal["jit", "pmap"] = "jit", transfer: Path | None = None
) -> Any:
    """Train, with a bar and lines on standard error, and return the state. Ends with status 1 if something is not finite, with
    host_process.LOST if a host is lost."""
    if is_first():  # the others write nothing
        probe_folder(run, "--run")
    keep_memory()
    console = stderr()
    for warning in getattr(dataset, "warnings", ()):
        console.print(f"warning: {dataset.folder}: {warning}", soft_wrap=True, markup=False)
    with bar(console, "compiling", config.kimg) as move:

        def show(row: dict[str, float]) -> None:
            losses = " ".join(f"{k} {row[k]:.3g}" for k in method_of(config).losses)
            line = f"{row['kimg']:.3f} kimg, {row['images_per_s']:.2f} images/s, losses {losses}"
            move(row["kimg"], what=line)
            if not console.is_terminal:
                console.print(line, soft_wrap=True)

        try:
            return train(config, dataset, run, how, show, transfer)
        except Diverged as fault:
            console.print(f"mesoshell: {run}: {fault}", soft_wrap=True, markup=False)
            sys.exit(1)
        except HostLost:
            console.print(f"mesoshell: {run}: {SAID_LOST}", soft_wrap=True, markup=False)
            sys.exit(LOST)


def print_length(run: Path, state: Any) -> None:
    """Print how far a run is."""
    print(f"{run}: {int(state.images) / 1000:.3f} kimg")
