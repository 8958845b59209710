"""`mesoshell render`: from options to a scene, from its picture to files. Only the engine that renders is imported."""

import json
import time
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from mesoshell.cli.checks import pairs_of, settings_of
from mesoshell.cli.options.render import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_outputs, replace_file, together
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import goal_of
from mesoshell.scene.materials import Material, load_material
from mesoshell.scene.picture import Picture, Prepared
from mesoshell.scene.prepare import OF_PATHS, prepare, quality_of
from mesoshell.scene.reach import picture_of
from mesoshell.scene.scene import Scene

#: Options that also apply to a scene of Mitsuba's.
_OF_SCENES = {"mesh", "engine", "spp", "quality", "set", "budget", "error", "max_samples", "explain", "out"}


def run(options: Options) -> None:
    """All of `mesoshell render`."""
    begin = time.perf_counter()
    if options.out.is_dir():
        raise InputError("--out", f"{options.out} is a folder")
    out = files_of(options.out)[0]
    probe_outputs(files_of(options.out))
    console = stderr()
    given = settings_of(options.set)
    given |= {name: getattr(options, name) for name in OF_PATHS if getattr(options, name) is not None}
    quality, compiling = quality_of(options.quality or "normal", options.engine, given), None
    goal = goal_of(options.budget, options.error, options.max_samples, given)
    if options.mesh.suffix.lower() == ".xml":
        ready = _of_mitsuba(options, quality)
    else:
        material = load_material(options.material)
        if options.engine == "jax":
            from mesoshell.cli.compilation_cache import keep_compiled

            compiling = keep_compiled()
        with bar(console, "growing") as progress:
            ready = prepare(scene_of(options, material), quality, options.engine, progress)
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
        said = "" if compiling is None else f"; {sum(compiling):.1f} s of this compiling"
        console.print(stages + said, soft_wrap=True)
    print(out)


def scene_of(options: Options, material: Material) -> Scene:
    """The scene that the options describe. Raises InputError for a parameter that has no value."""
    return Scene(
        mesh=options.mesh,
        material=material,
        thickness=options.thickness,
        scale=options.scale,
        params=pairs_of("--param", options.param),
        seed=options.seed,
        size=options.size,
        camera=options.camera,
        lights=options.light,
        irradiance=options.irradiance,
        environment=options.environment,
        base_colour=options.base,
        objects=options.object,
        up=options.up,
        transparent=options.transparent,
    )


def _of_mitsuba(options: Options, quality: Quality) -> Prepared:
    """A scene of Mitsuba's own. Raises InputError for options that are set in its file."""
    if options.engine != "mitsuba":
        raise InputError(options.mesh, "is a scene of Mitsuba's, which requires --engine mitsuba")
    for field in fields(Options):
        default = field.default_factory() if field.default_factory is not MISSING else field.default
        if field.name not in _OF_SCENES and getattr(options, field.name) != default:
            raise InputError(f"--{field.name.replace('_', '-')}", f"is set in {options.mesh}")
    given = settings_of(options.set)
    for name in ("max_depth", "rr_depth"):
        if name in given:
            raise InputError(f"--set {name}", f"is set in {options.mesh}")
    from mesoshell.scene.render_paths import prepare_file

    return prepare_file(options.mesh, quality, options.spp or given.get("spp"))


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
    with together(files_of(out)[0]) as folder:
        image, radiance, record = (folder / path.name for path in files_of(out))
        made.save(image)
        made.save(radiance)
        replace_file(record, (json.dumps(report, indent=1) + "\n").encode())


def files_of(out: Path) -> tuple[Path, Path, Path]:
    """The picture, its radiance and its report."""
    shown = out if out.suffix == ".png" or not out.name else out.with_suffix(".png")
    return shown, shown.with_suffix(".exr"), shown.with_suffix(".json")
