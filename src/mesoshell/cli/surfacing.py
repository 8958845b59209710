"""Pictures of a mesh that wears a surface material, one query a hit: `mesoshell render` with a bundle of kind "silhouette"."""

import time

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.description import camera_of, check_colours, lights_of, up_axis
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import bounding_box, is_convex, load_mesh
from mesoshell.io.material import find
from mesoshell.io.surface import SurfaceBundle, read_surface
from mesoshell.render.quality import PRESETS
from mesoshell.silhouette.material import SurfaceConfig, tables
from mesoshell.silhouette.renderer import Ready, SurfaceScene, plan, render
from mesoshell.train.surface_snapshot import surface_of

#: Of shells: a surface material is one texture without parameters.
_OF_SHELLS = ("param", "seed", "thickness")


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    compiled = keep_compiled()
    for name in _OF_SHELLS:
        if getattr(options, name) not in ((), None):
            raise InputError(f"--{name}", f"{options.material} is a surface material: it has none (see --scale)")
    bundle, quality = read_surface(find(options.material)), PRESETS[options.quality]
    scene, notes = build_scene(options, bundle)
    effects = plan(scene, is_convex(scene.mesh))
    if options.explain:
        say_effects(console, effects.as_dict())
    setup = time.perf_counter() - begin
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
        "provenance": bundle.provenance,
        "compile_seconds": sum(compiled),
    }
    return Picture(image.astype(np.float32), {"setup": setup, **report.seconds}, record)


def build_scene(options: Options, bundle: SurfaceBundle) -> tuple[SurfaceScene, tuple[str, ...]]:
    """The scene that the options describe, and what the user should know about it."""
    check_colours(options)
    mesh = load_mesh(options.mesh)
    box, up = bounding_box(mesh), up_axis(options)
    period = float(np.linalg.norm(box[1] - box[0])) * 2 / 25 if options.scale is None else options.scale
    if not (np.isfinite(period) and period > 0):
        raise InputError("--scale", f"must be above 0, not {period:g}")
    camera = camera_of(options, box, 0.0, up)
    lights, sky = lights_of(options, camera, up)
    scene = SurfaceScene(
        mesh=mesh,
        ready=ready(bundle),
        period=period,
        camera=camera,
        lights=lights,
        environment=sky,
        base_colour=options.base,
        objects=tuple(load_mesh(p) for p in options.object),
        transparent=options.transparent,
    )
    return scene, mesh.notes


def ready(bundle: SurfaceBundle) -> Ready:
    """A bundle's network, ready to be asked."""
    hidden = tuple(
        bundle.arrays[f"reflectance/hidden/{i}/bias"].shape[0]
        for i in range(sum(key.startswith("reflectance/hidden/") for key in bundle.arrays) // 2)
    )
    config = SurfaceConfig(bundle.texels, bundle.channels, hidden, bundle.opacity, bundle.sees_curvature)  # type: ignore[arg-type]
    return Ready(config, tables(surface_of(bundle), jnp.asarray(1e-3, jnp.float32)), bundle.curvature)
