"""The work of `mesoshell dataset render-patches`: queries for materials with silhouettes."""

import json
import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mesoshell.cli.options.dataset import RenderPatches
from mesoshell.errors import InputError
from mesoshell.limits import check_memory
from mesoshell.mesostructure.render import Answers, Settings, of_geometry
from mesoshell.mesostructure.render import render_patches as write
from mesoshell.mesostructure.sources import source

#: Light paths of a query.
MOST = 2**24


def render_patches(command: RenderPatches) -> None:
    """All of `mesoshell dataset render-patches`."""
    for name, least in (("patches", 1), ("queries", 1), ("spp", 1), ("seed", 0)):
        if getattr(command, name) < least:
            raise InputError(f"--{name}", f"must be at least {least}, not {getattr(command, name)}")
    if command.depth is not None and not 0 < command.depth <= 1:
        raise InputError("--depth", f"must be above 0 and at most 1, not {command.depth}")
    tile = source(command.source, command.depth)
    settings = Settings(command.source, tile.depth, command.curvature, command.queries, command.spp, command.seed)
    written(settings, of_geometry(tile, command.spp), command.patches, command.out)


def written(settings: Settings, answers: Answers, count: int, folder: Path) -> None:
    """A dataset of patches, with a bar, and a line of what was done. Raises InputError before for what memory does not hold."""
    check_memory("--patches", f"a plan of {count} patches", 64 * count)
    check_memory("--queries", f"{settings.queries} queries on a patch", 512 * settings.queries)
    if settings.spp > MOST:
        raise InputError("--spp", f"{settings.spp} must be at most {MOST}")
    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn(settings.source),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    begin = time.monotonic()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None)
        spent = write(settings, answers, count, folder, lambda done, of: bar.update(task, completed=done, total=of))
    new, seconds = int(spent["new"]), time.monotonic() - begin
    print(f"{folder}: {count - new} patches were there, {new} are new")
    if new:
        rate = new * settings.queries / seconds * 60
        stages = ", ".join(f"{name} {spent[name] / new:.2f}" for name in ("geometry", "light") if spent[name])
        print(f"{rate / 1e6:.2f} million queries a minute" + (f"; seconds a patch: {stages}" if stages else ""))


def planned(folder: Path) -> int | None:
    """How many patches a dataset was begun with, or none if there is none that can be read."""
    try:
        return json.loads((folder / "manifest.json").read_text())["count"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
