"""`mesoshell dataset render`, `vary` and `cost`: what Blender makes."""

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.cli.checks import at_least
from mesoshell.cli.options.dataset import Cost, Recipe, Render, Vary
from mesoshell.cli.progress import bar, stderr
from mesoshell.datasets.blender import cost as table
from mesoshell.datasets.blender.cost import SPP, Cell, measure_cost, reference_image
from mesoshell.datasets.blender.process import Blender, Crash
from mesoshell.datasets.blender.render import DatasetReport, Farm, render_dataset
from mesoshell.datasets.blender.shard import Fault
from mesoshell.datasets.blender.vary import vary_sheet
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_outputs, replace_file
from mesoshell.io.image import write_png
from mesoshell.limits import check_memory

#: Seconds between two lines of progress where no terminal shows a bar.
_SILENCE_S = 30.0


def render(options: Render) -> None:
    """Render the samples that are missing; exit status 1 if some failed."""
    at_least(options, count=1, size=1, seed=0, spp=1, patch=0, patches=1, views=1, workers=1)
    if options.scheduler and options.workers:
        raise InputError("--workers", "cannot be combined with --scheduler, whose workers they are")
    count = _count(options)
    check_memory("--count", f"a plan of {count} images", 64 * count)
    settings = _settings(options, options.spp, options.denoise, options.coverage)
    settings |= {"patch": options.patch, "views": options.views, "tiles": options.tiles}
    cores = _cores()
    workers = min(options.workers or cores, count)
    farm = Farm(workers, 2 if options.scheduler else max(2, cores // workers), options.scheduler)
    report, seconds = _rendered(settings, options, count, farm)
    print(_summary(options, count, report, seconds))
    sys.exit(1 if report.faults else 0)


def _count(options: Render) -> int:
    """Images in all. Raises InputError unless either --count or both --patches and --views are given."""
    others = [f"--{name}" for name in ("patch", "patches", "views") if getattr(options, name) is not None]
    if options.tiles and others:
        raise InputError("--tiles", f"cannot be combined with {' and '.join(others)}")
    if options.patches is None and options.views is None:
        if options.count is None:
            raise InputError("--count", "give it, or both --patches and --views")
        return options.count
    if options.patches is None or options.views is None:
        raise InputError(
            *(("--patches", "requires --views") if options.views is None else ("--views", "requires --patches"))
        )
    for name in ("count", "patch"):
        if getattr(options, name) is not None:
            raise InputError(f"--{name}", "cannot be combined with --patches and --views")
    return options.patches * options.views


def _rendered(settings: dict[str, Any], options: Render, count: int, farm: Farm) -> tuple[DatasetReport, float]:
    console = stderr()
    start = reported = time.monotonic()
    with bar(console, options.recipe, None, count=True) as move:

        def show(finished: int, missing: int, fault: Fault | None) -> None:
            nonlocal reported
            now = time.monotonic()
            rate = 60.0 * finished / max(now - start, 1e-9)
            move(finished, missing, f"{options.recipe}, {rate:.0f} images/min")
            if fault:
                console.print(f"sample {fault.index}: {fault.reason}", markup=False, soft_wrap=True)
            if not console.is_terminal and finished and now - reported > _SILENCE_S:
                reported = now
                left = (missing - finished) / rate
                console.print(f"{finished}/{missing} images, {rate:.0f} images/min, {left:.1f} min left")

        report = render_dataset(settings, count, options.out, farm, show)
    return report, time.monotonic() - start


def _summary(options: Render, count: int, report: DatasetReport, seconds: float) -> str:
    new = len(report.logs)
    kept = count - new - len(report.faults)
    lines = [f"{options.out}: {kept} samples were there, {new} are new"]
    if report.faults:
        lines[0] += f", {len(report.faults)} failed; the same command tries them again"
    if report.logs:
        stages = {stage: np.mean([log["seconds"][stage] for log in report.logs]) for stage in report.logs[0]["seconds"]}
        lines.append(f"{60.0 * new / seconds:.0f} images a minute; seconds a sample: ")
        lines[-1] += ", ".join(f"{stage} {mean:.3f}" for stage, mean in stages.items())
        sizes = [(options.out / f"images/{log['index']:06d}.exr").stat().st_size for log in report.logs]
        lines.append(f"{np.mean(sizes):.0f} bytes a sample; ")
        lines[-1] += f"at most {max(log['memory_mib'] for log in report.logs):.0f} MiB a process"
    return "\n".join(lines)


def vary(options: Vary) -> None:
    """Write a sheet, a parameter a row."""
    at_least(options, size=1, seed=0, spp=1, steps=2, index=0)
    probe_outputs((options.out,))
    settings = _settings(options, options.spp, False, (0.85, 0.85))
    try:
        with Blender(settings, _cores()) as blender, bar(stderr(), options.recipe, None, count=True) as show:
            picture = vary_sheet(blender, options.steps, options.index, show)
    except Crash as crash:
        raise InputError(options.recipe, str(crash)) from None
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_png(options.out, picture)
    print(f"{options.out}: rows are {', '.join(blender.manifest['parameters'])}; columns from least to greatest")


def cost(options: Cost) -> None:
    """Print a table, a number of light paths a row, and write it as JSON to --out."""
    at_least(options, size=1, seed=0, index=0)
    probe_outputs(() if options.out is None else (options.out,))
    settings = _settings(options, None, False, (options.coverage, options.coverage))
    cells: list[Cell] = []
    try:
        with (
            Blender(settings, _cores()) as blender,
            bar(stderr(), f"{options.recipe} at {table.REFERENCE}", table.REFERENCE + 2 * sum(SPP)) as show,
            tempfile.TemporaryDirectory() as scratch,
        ):
            reference, seconds = reference_image(blender, options.index, Path(scratch))
            done = table.REFERENCE
            show(done)
            print(
                f"{options.recipe}, sample {options.index}, {options.size}², against {table.REFERENCE} paths a pixel "
                f"({seconds:.1f} s)"
            )
            print(f"{'paths':>6}  {'plain':>9}  {'seconds':>8}  {'denoised':>9}  {'seconds':>8}")
            for spp in SPP:
                row = [measure_cost(blender, options.index, Path(scratch), spp, d, reference) for d in (False, True)]
                done += 2 * spp
                show(done, what=f"{options.recipe} at {spp}")
                print(f"{spp:>6}  " + "  ".join(f"{cell.psnr:6.1f} dB  {cell.seconds:8.2f}" for cell in row))
                cells += row
    except Crash as crash:
        raise InputError(options.recipe, str(crash)) from None
    print("error: foreground PSNR of x / (1 + x); seconds: geometry kept, one image, all cores")
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        replace_file(options.out, (json.dumps([cell._asdict() for cell in cells], indent=1) + "\n").encode())


def _settings(
    options: Recipe,
    spp: int | None,
    denoise: bool,
    coverage: tuple[float, float] | None,
) -> dict[str, Any]:
    # Blender holds a few copies in float32
    check_memory("--size", f"pictures of {options.size} x {options.size}", 64 * options.size**2)
    return {
        "recipe": options.recipe,
        "seed": options.seed,
        "size": options.size,
        "samples_per_pixel": spp,
        "denoise": denoise,
        "coverage": coverage,
        "fixed": dict(_assigned(pair) for pair in options.param),
        "patch": None,
        "views": None,
        "tiles": False,
    }


def _assigned(pair: str) -> tuple[str, float]:
    name, equals, text = pair.partition("=")
    try:
        if equals:
            return name, float(text)
    except ValueError:
        pass
    raise InputError("--param", f"{pair} is not NAME=NUMBER")


def _cores() -> int:
    return len(os.sched_getaffinity(0))
