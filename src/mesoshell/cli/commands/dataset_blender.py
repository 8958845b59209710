"""The work of `mesoshell dataset render`, `vary` and `cost`: what Blender makes."""

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn

from mesoshell.cli.options.dataset import Cost, Recipe, Render, Vary
from mesoshell.errors import InputError
from mesoshell.farm import cost as table
from mesoshell.farm.blender import Blender, Crash
from mesoshell.farm.cost import SPP, Cell, measure_cost, reference_image
from mesoshell.farm.render import Farm, Report, render_dataset
from mesoshell.farm.shard import Fault
from mesoshell.farm.vary import vary_sheet
from mesoshell.io.image import write_png
from mesoshell.io.whole import probe_outputs, replace_file
from mesoshell.limits import check_memory

#: Seconds between two lines of progress where there is no terminal to draw a bar on.
_SILENCE_S = 30.0


def render(command: Render) -> None:
    _at_least(command, count=1, size=1, seed=0, spp=1, patch=0, patches=1, views=1, workers=1)
    count = _count(command)
    check_memory("--count", f"a plan of {count} images", 64 * count)
    settings = _settings(command, command.spp, command.denoise, command.coverage, command.patch, command.views)
    cores = len(os.sched_getaffinity(0))
    workers = min(command.workers or cores, count)
    farm = Farm(workers, 2 if command.scheduler else max(2, cores // workers), command.scheduler)
    report, seconds = _rendered(settings, command, count, farm)
    print(_summary(command, count, report, seconds))
    sys.exit(1 if report.faults else 0)


def _count(command: Render) -> int:
    """Images in all. Raises InputError unless either --count or both --patches and --views are given."""
    if command.patches is None and command.views is None:
        if command.count is None:
            raise InputError("--count", "is missing: give it, or --patches and --views")
        return command.count
    if command.patches is None or command.views is None:
        raise InputError("--views" if command.views is None else "--patches", "is missing: --patches needs --views")
    for name in ("count", "patch"):
        if getattr(command, name) is not None:
            raise InputError(f"--{name}", "does not go with --patches and --views")
    return command.patches * command.views


def _rendered(settings: dict[str, Any], command: Render, count: int, farm: Farm) -> tuple[Report, float]:
    console = Console(stderr=True, highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
    start = said = time.monotonic()
    with _progress(console, *columns, TextColumn("left"), TimeRemainingColumn()) as bar:
        task = bar.add_task(command.recipe, total=None, rate="")

        def show(finished: int, missing: int, fault: Fault | None) -> None:
            nonlocal said
            now = time.monotonic()
            rate = 60.0 * finished / max(now - start, 1e-9)
            bar.update(task, completed=finished, total=missing, rate=f"{rate:.0f} images/min")
            if fault:
                console.print(f"sample {fault.index}: {fault.reason}", markup=False, soft_wrap=True)
            if not console.is_terminal and finished and now - said > _SILENCE_S:
                said = now
                left = (missing - finished) / rate
                console.print(f"{finished}/{missing} images, {rate:.0f} images/min, {left:.1f} min left")

        report = render_dataset(settings, count, command.out, farm, show)
    return report, time.monotonic() - start


def _progress(console: Console, *columns: ProgressColumn) -> Progress:
    """A bar that leaves nothing behind, and is not there where nobody looks."""
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def _summary(command: Render, count: int, report: Report, seconds: float) -> str:
    new = len(report.logs)
    kept = count - new - len(report.faults)
    lines = [f"{command.out}: {kept} samples were there, {new} are new"]
    if report.faults:
        lines[0] += f", {len(report.faults)} failed; the same command tries them again"
    if report.logs:
        stages = {stage: np.mean([log["seconds"][stage] for log in report.logs]) for stage in report.logs[0]["seconds"]}
        lines.append(f"{60.0 * new / seconds:.0f} images a minute; seconds a sample: ")
        lines[-1] += ", ".join(f"{stage} {mean:.3f}" for stage, mean in stages.items())
        sizes = [(command.out / f"images/{log['index']:06d}.exr").stat().st_size for log in report.logs]
        lines.append(f"{np.mean(sizes):.0f} bytes a sample; ")
        lines[-1] += f"at most {max(log['memory_mib'] for log in report.logs):.0f} MiB a process"
    return "\n".join(lines)


def vary(command: Vary) -> None:
    _at_least(command, size=1, seed=0, spp=1, steps=2, index=0)
    probe_outputs((command.out,))
    settings = _settings(command, command.spp, False, (0.85, 0.85))
    console = Console(stderr=True)
    try:
        with Blender(settings, _cores()) as blender, _progress(console) as bar:
            task = bar.add_task(command.recipe, total=None)
            picture = vary_sheet(
                blender, command.steps, command.index, lambda done, of: bar.update(task, completed=done, total=of)
            )
    except Crash as crash:
        raise InputError(command.recipe, str(crash)) from None
    write_png(command.out, picture)
    print(f"{command.out}: rows are {', '.join(blender.manifest['parameters'])}; columns from least to greatest")


def cost(command: Cost) -> None:
    _at_least(command, size=1, seed=0, index=0)
    probe_outputs(() if command.out is None else (command.out,))
    settings = _settings(command, None, False, (command.coverage, command.coverage))
    cells: list[Cell] = []
    try:
        with (
            Blender(settings, _cores()) as blender,
            _progress(Console(stderr=True)) as bar,
            tempfile.TemporaryDirectory() as scratch,
        ):
            work = table.REFERENCE + 2 * sum(SPP)
            task = bar.add_task(f"{command.recipe} at {table.REFERENCE}", total=work)
            reference, seconds = reference_image(blender, command.index, Path(scratch))
            bar.update(task, advance=table.REFERENCE)
            print(
                f"{command.recipe}, sample {command.index}, {command.size}², against {table.REFERENCE} paths a pixel "
                f"({seconds:.1f} s)"
            )
            print(f"{'paths':>6}  {'plain':>9}  {'seconds':>8}  {'denoised':>9}  {'seconds':>8}")
            for spp in SPP:
                row = [measure_cost(blender, command.index, Path(scratch), spp, d, reference) for d in (False, True)]
                bar.update(task, advance=2 * spp, description=f"{command.recipe} at {spp}")
                print(f"{spp:>6}  " + "  ".join(f"{cell.psnr:6.1f} dB  {cell.seconds:8.2f}" for cell in row))
                cells += row
    except Crash as crash:
        raise InputError(command.recipe, str(crash)) from None
    print("error: foreground PSNR of x / (1 + x); seconds: geometry kept, one image, all cores")
    if command.out:
        replace_file(command.out, (json.dumps([cell._asdict() for cell in cells], indent=1) + "\n").encode())


def _settings(
    command: Recipe,
    spp: int | None,
    denoise: bool,
    coverage: tuple[float, float] | None,
    patch: int | None = None,
    views: int | None = None,
) -> dict[str, Any]:
    # Blender's: as floats, in a few copies
    check_memory("--size", f"pictures of {command.size} x {command.size}", 64 * command.size**2)
    return {
        "recipe": command.recipe,
        "seed": command.seed,
        "size": command.size,
        "samples_per_pixel": spp,
        "denoise": denoise,
        "coverage": coverage,
        "fixed": dict(_assigned(pair) for pair in command.param),
        "patch": patch,
        "views": views,
    }


def _assigned(pair: str) -> tuple[str, float]:
    name, equals, text = pair.partition("=")
    try:
        if equals:
            return name, float(text)
    except ValueError:
        pass
    raise InputError("--param", f"{pair} is not NAME=NUMBER")


def _at_least(command: object, **least: int) -> None:
    for name, low in least.items():
        value = getattr(command, name)
        if value is not None and value < low:
            raise InputError(f"--{name}", f"must be at least {low}, not {value}")


def _cores() -> int:
    return len(os.sched_getaffinity(0))
