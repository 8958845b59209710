"""`mesoshell render`: from options to a scene, from its picture to files. Only the engine that renders is imported."""

import json
import time
from pathlib import Path
from typing import Any

from mesoshell.cli.checks import settings_of
from mesoshell.cli.described_scene import compiled_by, is_mitsubas, prepare_with_bar
from mesoshell.cli.options.render import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import move_together, probe_outputs, replace_file
from mesoshell.scene.accumulate import goal_of
from mesoshell.scene.picture import Picture
from mesoshell.scene.prepare import FIXED_BY_XML, PATH_FIELDS, quality_of
from mesoshell.scene.reach import picture_of


def run(options: Options) -> None:
    """All of `mesoshell render`."""
    begin = time.perf_counter()
    if options.out.is_dir():
        raise InputError("--out", f"{options.out} is a folder")
    out = files_of(options.out)[0]
    probe_outputs(files_of(options.out))
    console = stderr()
    given = settings_of(options.set)
    given |= {name: getattr(options, name) for name in PATH_FIELDS if getattr(options, name) is not None}
    quality = quality_of(options.quality or "normal", options.engine, given)
    goal = goal_of(options.budget, options.error, options.max_samples, given)
    for name in (name for name in FIXED_BY_XML if name in given and is_mitsubas(options.mesh)):
        option = f"--set {name}" if getattr(options, name, None) is None else f"--{name.replace('_', '-')}"
        raise InputError(option, f"is set in {options.mesh}")
    compiling = compiled_by(options.engine)
    with bar(console, "growing") as progress:
        ready = prepare_with_bar(options, quality, options.spp or given.get("spp"), progress)
    say_notes(console, ready.notes)
    if options.explain and ready.effects is not None:
        console.print(str(ready.effects), soft_wrap=True)
    with bar(console, "rendering") as progress:
        made = picture_of(ready, quality, goal, not (options.quality or given), progress)
    unused = [name for name in given if name not in made.report["quality"]]
    say_notes(
        console, [*made.notes[len(ready.notes) :], *(f"{name}: has no effect on this picture" for name in unused)]
    )
    if goal is not None:
        console.print(_reached(made.report["goal"]), soft_wrap=True)
    report = _report(made, begin, compiling)
    _write(options.out, made, report)
    if options.explain:
        stages = ", ".join(f"{k} {v:.2f} s" for k, v in report["seconds"].items())
        compiled = "" if compiling is None else f"; {sum(compiling):.1f} s of this compiling"
        console.print(stages + compiled, soft_wrap=True)
    print(out)


def _reached(goal: dict[str, Any]) -> str:
    """What was promised and what was reached, in a line."""
    promised, samples = goal["promised"], goal["samples"]
    ends = {
        "budget": "budget spent",
        "error": "error reached",
        "max_samples": "most samples taken",
        "interrupt": "interrupted",
    }
    seconds = f"{goal['seconds']:.2f} s" + ("" if promised["budget"] is None else f" of {promised['budget']:g} s")
    noise = "unknown" if goal["noise"] is None else f"{goal['noise']:.4f}"
    bias = f", of bias {goal['bias']:.4f}" if "bias" in goal else ""
    error = f"estimated FLIP of noise {noise}{bias}" + (
        "" if promised["error"] is None else f" for {promised['error']:g}"
    )
    counts = f"{samples['mean']:.1f} samples a pixel"
    if samples["least"] < samples["most"]:
        counts += f" ({samples['least']} to {samples['most']})"
    chosen = "".join(f", {name}={value}" for name, value in goal.get("settings", {}).items())
    return f"{ends[goal['met']]}: {seconds}; {error}; {counts}{chosen}"


def _report(made: Picture, begin: float, compiling: list[float] | None) -> dict[str, Any]:
    """The picture's report, with the seconds of the whole command."""
    report = dict(made.report)
    last = {name: report.pop(name) for name in ("material", "seconds")}
    last["seconds"]["total"] = time.perf_counter() - begin
    return report | ({} if compiling is None else {"compile_seconds": sum(compiling)}) | last


def _write(out: Path, made: Picture, report: dict[str, Any]) -> None:
    with move_together(files_of(out)[0]) as folder:
        image, radiance, record = (folder / path.name for path in files_of(out))
        made.save(image)
        made.save(radiance)
        replace_file(record, (json.dumps(report, indent=1) + "\n").encode())


def files_of(out: Path) -> tuple[Path, Path, Path]:
    """The picture, its radiance and its report."""
    ended = out.suffix.lower() in (".png", ".exr", ".json")
    shown = out if not out.name else out.with_suffix(".png") if ended else out.with_name(f"{out.name}.png")
    return shown, shown.with_suffix(".exr"), shown.with_suffix(".json")
