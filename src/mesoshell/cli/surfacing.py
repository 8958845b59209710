"""Pictures of a mesh that wears a surface material, one query a hit: `mesoshell render` with a bundle of kind "silhouette"."""

import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.description import describe_surface
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects
from mesoshell.geometry.mesh import is_convex
from mesoshell.io.material import find
from mesoshell.io.surface import read_surface
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.silhouette.ready import ready
from mesoshell.silhouette.renderer import SurfaceEffects, SurfaceScene, plan, render


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    compiled = keep_compiled()
    bundle, quality = read_surface(find(options.material)), PRESETS[options.quality]
    d = describe_surface(options)
    scene = SurfaceScene(**vars(d), ready=ready(bundle))
    effects = plan(scene, is_convex(scene.mesh))
    if options.explain:
        say_effects(console, effects.as_dict())
    setup = time.perf_counter() - begin
    image, seconds, record = shown(scene, quality, effects, console, d.mesh.notes)
    record |= {"provenance": bundle.provenance, "compile_seconds": sum(compiled)}
    return Picture(image, {"setup": setup} | seconds, record)


def shown(
    scene: SurfaceScene, quality: Quality, effects: SurfaceEffects, console: Console, notes: tuple[str, ...] = ()
) -> tuple[np.ndarray, dict[str, float], dict[str, Any]]:
    """A picture, seconds by stage, and what the report says of it; a bar and notes on the console."""
    columns = (TextColumn("rendering"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        image, report = render(scene, quality, effects, lambda share: bar.update(task, completed=share))
    for note in (*notes, *report.notes):
        console.print(f"[dim]note:[/] {note}", highlight=False, soft_wrap=True)
    record = {
        "rays": report.counts.get("rays", 0),
        "queries": report.counts.get("queries", 0),
        "counts": report.counts,
        "effects": effects.as_dict(),
        "quality": quality.as_dict(),
    }
    return image.astype(np.float32), report.seconds, record
