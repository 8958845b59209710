"""`mesoshell dataset check`, `pack` and `sheet`: datasets that exist."""

import sys

from mesoshell.cli.checks import at_least
from mesoshell.cli.options.dataset import Check, Pack, Sheet
from mesoshell.io.atomic import probe_outputs
from mesoshell.io.dataset import read_dataset
from mesoshell.io.dataset_check import check_dataset
from mesoshell.io.image import write_png
from mesoshell.io.pack import pack_dataset
from mesoshell.io.sheet import contact_sheet


def check(options: Check) -> None:
    """Print every fault; exit status 1 if there is one."""
    faults = check_dataset(options.folder)
    print("\n".join([*faults, f"{options.folder}: {len(faults) or 'no'} fault{'s' * (len(faults) != 1)}"]))
    sys.exit(1 if faults else 0)


def pack(options: Pack) -> None:
    """Write the arrays, and print how large they are."""
    dataset = read_dataset(options.folder)
    written, count = pack_dataset(dataset, options.out, options.size), len(dataset.samples)
    print(f"{options.out}: {count} samples, {written / 1e6:.1f} MB, {written / count:.0f} bytes each")


def sheet(options: Sheet) -> None:
    """Write the contact sheet."""
    at_least(options, count=1, columns=1)
    probe_outputs((options.out,))
    picture = contact_sheet(read_dataset(options.folder), options.sort, options.count, options.columns)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_png(options.out, picture)
    print(options.out)
