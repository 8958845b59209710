"""`mesoshell dataset`: training images from Blender, in an environment of its own, called as a subprocess."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mesoshell.errors import InputError

PYTHON = Path("data_gen/.venv/bin/python")


@dataclass(frozen=True)
class Render:
    """Render training images with Blender; a run that was interrupted goes on where it stopped."""

    #: The recipe: grass.
    recipe: tyro.conf.Positional[str]
    #: Number of images.
    count: int
    #: Folder to write.
    out: Path
    #: Side of the square images in pixels.
    size: int = 64
    #: Samples a pixel.
    spp: int = 64
    #: Seed of cameras, lights and parameters.
    seed: int = 0
    #: Fix a parameter: NAME=VALUE; may be repeated.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    #: Least and greatest side of the box over the width of the frame.
    coverage: tuple[float, float] | None = None


@dataclass(frozen=True)
class Check:
    """Look for every fault of a dataset; exit status 1 if there is one."""

    #: Dataset folder.
    folder: tyro.conf.Positional[Path]


def run(command: Annotated[Render | Check, tyro.conf.arg(name="")]) -> None:
    """Make and check datasets of training images."""
    if isinstance(command, Check):
        _check(command)
    else:
        _render(command)


def _check(command: Check) -> None:
    from mesoshell.io.dataset import check_dataset, read_dataset

    count = len(read_dataset(command.folder).samples)
    faults = check_dataset(command.folder)
    print("\n".join([*faults, f"{count} samples, {len(faults)} faults"]))
    sys.exit(1 if faults else 0)


def _render(command: Render) -> None:
    if not PYTHON.exists():
        raise InputError(PYTHON, "no Blender environment; make it with: make blender")
    arguments = [command.recipe, "--count", command.count, "--size", command.size, "--spp", command.spp]
    arguments += ["--seed", command.seed, "--out", command.out]
    for pair in command.param:
        arguments += ["--param", pair]
    if command.coverage:
        arguments += ["--coverage", *command.coverage]
    sys.exit(subprocess.run([str(PYTHON), "-m", "data_gen.render", *map(str, arguments)]).returncode)
