"""Pictures of a mesh that wears a surface material, one query a hit: `mesoshell render` with a bundle of kind "silhouette"."""

import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.description import describe_surface
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects, say_notes
from mesoshell.io.material import find
from mesoshell.io.surface import read_surface
from mesoshell.render.effects import SURFACE, Effects, left_out
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.render.used import quality_used
from mesoshell.silhouette.ready import ready
from mesoshell.silhouette.renderer import SurfaceScene, plan, render


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    compiled = keep_compiled()
    bundle, quality = read_surface(find(options.material)), PRESETS[options.quality]
    d = describe_surface(options)
    scene = SurfaceScene(**vars(d), ready=ready(bundle))
    effects = plan(scene, quality)
    say_notes(console, left_out(effects))
    if options.explain:
        say_effects(console, effects.as_dict())
    setup = time.perf_counter() - begin
    image, seconds, record = shown(scene, quality, effects, console, d.mesh.notes)
    record |= {"provenance": bundle.provenance, "compile_seconds": sum(compiled)}
    return Picture(image, {"setup": setup} | seconds, record)


def shown(
    scene: SurfaceScene, quality: Quality, effects: Effects, console: Console, notes: tuple[str, ...] = ()
) -> tuple[np.ndarray, dict[str, float], dict[str, Any]]:
    """A picture, seconds by stage, and what the report says of it; a bar and notes on the console."""
    columns = (TextColumn("rendering"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        image, report = render(scene, quality, effects, lambda share: bar.update(task, completed=share))
    say_notes(console, (*notes, *report.notes))
    record = {
        "rays": report.counts.get("rays", 0),
        "queries": report.counts.get("queries", 0),
        "counts": report.counts,
        "effects": effects.as_dict(),
        "quality": quality_used(quality, effects, SURFACE),
    }
    return image.astype(np.float32), report.seconds, record
