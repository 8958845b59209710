"""A dataset of queries, written with a bar."""

import time
from pathlib import Path

from mesoshell.cli.progress import bar, stderr
from mesoshell.datasets.queries.render import Answers, Settings, render_patches
from mesoshell.errors import InputError
from mesoshell.limits import check_memory

#: Memory of a query, and of each of its light paths, bytes.
QUERY, PATH = 512, 320


def write_queries(settings: Settings, answers: Answers, count: int, folder: Path) -> None:
    """Write the missing ones of `count` patches, and print what was done. Raises InputError."""
    check_memory("--patches", f"a plan of {count} patches", 64 * count)
    queries, spp = settings.queries, settings.spp
    check_memory("--queries", f"{queries} queries on a patch", QUERY * queries)
    check_memory("--spp", f"{spp} light paths for each of {queries} queries", PATH * queries * spp)
    if queries * spp >= 2**32:  # Dr.Jit counts in 32 bits
        raise InputError("--spp", f"times --queries must be below 2^32, not {queries * spp}")
    begin = time.monotonic()
    with bar(stderr(), settings.source, None, count=True) as show:
        spent = render_patches(settings, answers, count, folder, show)
    new, seconds = int(spent["new"]), time.monotonic() - begin
    print(f"{folder}: {count - new} patches were there, {new} are new")
    if new:
        rate = new * settings.queries / seconds * 60
        stages = ", ".join(f"{name} {spent[name] / new:.2f}" for name in ("geometry", "light") if spent[name])
        print(f"{rate / 1e6:.2f} million queries a minute" + (f"; seconds a patch: {stages}" if stages else ""))
