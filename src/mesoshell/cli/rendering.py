"""The work of `mesoshell render`: a picture by one of the engines, and its files. Only the engine that renders is imported."""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rich.console import Console

from mesoshell import __version__
from mesoshell.cli.render import Options, parse_params
from mesoshell.errors import InputError
from mesoshell.io.image import write_exr, write_png
from mesoshell.io.material import find
from mesoshell.io.surface import KIND, kind_of
from mesoshell.io.whole import probe_outputs, replace_file, together

#: Of what is counted a pixel: samples, bounces.
MOST = 2**24


@dataclass(frozen=True, eq=False)
class Picture:
    """Linear RGBA; seconds by stage; record: what else the report says, as JSON."""

    image: Float[np.ndarray, "H W 4"]
    seconds: dict[str, float]
    record: dict[str, Any]


def render_to_files(options: Options) -> None:
    """All of `mesoshell render`."""
    begin = time.perf_counter()
    if options.out.is_dir():
        raise InputError("--out", f"{options.out} is a folder")
    out = files_of(options.out)[0]
    probe_outputs(files_of(options.out))
    console = Console(stderr=True)
    for name in ("spp", "max_depth"):
        value = getattr(options, name)
        if value is not None and options.engine != "mitsuba":
            raise InputError(f"--{name.replace('_', '-')}", "requires --engine mitsuba")
        if value is not None and value < 1:
            raise InputError(f"--{name.replace('_', '-')}", f"{value} must be at least 1")
        if value is not None and value > MOST:
            raise InputError(f"--{name.replace('_', '-')}", f"{value} must be at most {MOST}")
    if options.engine == "mitsuba":
        from mesoshell.cli.path_tracing import picture
    elif options.mesh.suffix.lower() == ".xml":
        raise InputError(options.mesh, "is a scene of Mitsuba's: give --engine mitsuba")
    elif kind_of(find(options.material)) == KIND:
        from mesoshell.cli.surfacing import picture
    else:
        from mesoshell.cli.marching import picture
    found = picture(options, console)
    seconds = {**found.seconds, "total": time.perf_counter() - begin}
    material = {"name": options.material, "parameters": parse_params(options.param), **found.record.pop("provenance")}
    record = {
        "version": __version__,
        "engine": options.engine,
        **found.record,
        "material": material,
        "seconds": seconds,
    }
    with together(out) as folder:
        image, radiance, report = (folder / path.name for path in files_of(options.out))
        write_png(image, found.image)
        write_exr(radiance, found.image)
        replace_file(report, (json.dumps(record, indent=1) + "\n").encode())
    if options.explain:
        stages = ", ".join(f"{k} {v:.2f} s" for k, v in seconds.items())
        compiling = found.record.get("compile_seconds")
        said = "" if compiling is None else f"; {compiling:.1f} s of this compiling"
        console.print(stages + said, highlight=False, soft_wrap=True)
    print(out, file=sys.stdout)


def files_of(out: Path) -> tuple[Path, Path, Path]:
    """The picture, its radiance and its report."""
    picture = out if out.suffix == ".png" or not out.name else out.with_suffix(".png")
    return picture, picture.with_suffix(".exr"), picture.with_suffix(".json")


def say_notes(console: Console, notes: tuple[str, ...]) -> None:
    """What the user should know, a line each."""
    for note in notes:
        console.print(f"[dim]note:[/] {note}", highlight=False, soft_wrap=True)


def say_effects(console: Console, effects: dict[str, dict[str, Any]]) -> None:
    """One line an effect: whether it is compiled, and why."""
    for name, effect in effects.items():
        line = f"{'on ' if effect['on'] else 'off'} {name.replace('_', ' ')}: {effect['why']}"
        console.print(line, highlight=False, soft_wrap=True)
