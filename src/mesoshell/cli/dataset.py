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


@dataclass(frozen=True)
class Sheet:
    """Write a contact sheet: many of a dataset's images side by side."""

    #: Dataset folder.
    folder: tyro.conf.Positional[Path]
    #: The picture to write.
    out: Path = Path("sheet.png")
    #: Order of the images: a parameter, or "radius"; by index if not given.
    sort: str | None = None
    #: Number of images, evenly spaced in that order.
    count: int = 96
    #: Images a row.
    columns: int = 12


def run(command: Annotated[Render | Check | Sheet, tyro.conf.arg(name="")]) -> None:
    """Make, check and look at datasets of training images."""
    match command:
        case Check():
            _check(command)
        case Sheet():
            _sheet(command)
        case Render():
            _render(command)


def _check(command: Check) -> None:
    from mesoshell.io.dataset import check_dataset, read_dataset

    count = len(read_dataset(command.folder).samples)
    faults = check_dataset(command.folder)
    print("\n".join([*faults, f"{count} samples, {len(faults)} faults"]))
    sys.exit(1 if faults else 0)


def _sheet(command: Sheet) -> None:
    from mesoshell.io.dataset import read_dataset
    from mesoshell.io.image import write_png
    from mesoshell.io.sheet import contact_sheet

    for name in ("count", "columns"):
        if getattr(command, name) < 1:
            raise InputError(f"--{name}", "must be at least 1")
    write_png(command.out, contact_sheet(read_dataset(command.folder), command.sort, command.count, command.columns))
    print(command.out)


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
