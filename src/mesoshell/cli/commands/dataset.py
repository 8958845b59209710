"""The work of `mesoshell dataset check`, `pack` and `sheet`: datasets that exist."""

import sys
from pathlib import Path

from mesoshell.cli.options.dataset import Sheet
from mesoshell.errors import InputError
from mesoshell.io.dataset import check_dataset, read_dataset
from mesoshell.io.image import write_png
from mesoshell.io.pack import pack_dataset
from mesoshell.io.sheet import contact_sheet
from mesoshell.io.whole import probe_outputs


def check(folder: Path) -> None:
    faults = check_dataset(folder)
    print("\n".join([*faults, f"{folder}: {len(faults) or 'no'} fault{'s' * (len(faults) != 1)}"]))
    sys.exit(1 if faults else 0)


def pack(folder: Path, out: Path, size: int | None) -> None:
    dataset = read_dataset(folder)
    written = pack_dataset(dataset, out, size)
    print(
        f"{out}: {len(dataset.samples)} samples, {written / 1e6:.1f} MB, {written / len(dataset.samples):.0f} bytes each"
    )


def sheet(command: Sheet) -> None:
    for name in ("count", "columns"):
        if getattr(command, name) < 1:
            raise InputError(f"--{name}", "must be at least 1")
    probe_outputs((command.out,))
    write_png(command.out, contact_sheet(read_dataset(command.folder), command.sort, command.count, command.columns))
    print(command.out)
