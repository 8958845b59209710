"""Pictures by marching rays in JAX: the engine of `mesoshell render` unless another is asked for.

Alphabet
stretch     world length of one UV unit, averaged over the surface
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.description import Description, describe
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects, say_notes
from mesoshell.cli.standing import in_place, twin_facts
from mesoshell.cli.surfacing import shown
from mesoshell.geometry.enclosure import enclosure
from mesoshell.geometry.mesh import bounding_box, is_convex, uv_stretch
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import find
from mesoshell.render.camera import pixel_radius
from mesoshell.render.effects import MARCH, SURFACE, left_out, plan_effects, plan_twin
from mesoshell.render.facts import Facts
from mesoshell.render.quality import PRESETS
from mesoshell.render.used import quality_used
from mesoshell.shell.horizon import lowest
from mesoshell.shell.renderer import render
from mesoshell.shell.scene import Scene, ready
from mesoshell.silhouette.ready import ready as ready_surface
from mesoshell.silhouette.renderer import SurfaceScene
from mesoshell.silhouette.renderer import facts as surface_facts


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    compiled = keep_compiled()
    quality = PRESETS[options.quality]
    bundle = read_bundle(find(options.material))
    columns = (TextColumn("growing"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        d = describe(options, bundle, lambda share: bar.update(task, completed=share))
    say_notes(console, d.notes)
    found = twin_facts(options, bundle, d, quality)
    if bundle.twin is not None and plan_twin(found, quality).on:
        standing = SurfaceScene(**vars(in_place(d)), ready=ready_surface(bundle.twin.surface))
        effects = plan_effects(replace(surface_facts(standing), twin=found), quality, SURFACE)
        say_notes(console, left_out(effects))
        if options.explain:
            say_effects(console, effects.as_dict())
        setup = time.perf_counter() - begin
        image, seconds, record = shown(standing, quality, effects, console)
        record |= {"provenance": bundle.provenance, "compile_seconds": sum(compiled)}
        return Picture(image, {"setup": setup} | seconds, record)
    scene = scene_of(d)
    effects = plan_effects(replace(facts(scene), twin=found), quality)
    say_notes(console, left_out(effects))
    if options.explain:
        say_effects(console, effects.as_dict())
    setup = time.perf_counter() - begin
    columns = (TextColumn("rendering"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        image, report = render(scene, quality, effects, lambda share: bar.update(task, completed=share))
    counts = report.counts
    record = {
        "rays": counts.get("rays", 0),
        "queries": sum(counts.get(k, 0) for k in ("density_queries", "transport_queries", "surface_queries")),
        "counts": counts,
        "effects": effects.as_dict(),
        "quality": quality_used(quality, effects, MARCH),
        "provenance": bundle.provenance,
        "compile_seconds": sum(compiled),
    }
    return Picture(image.astype(np.float32), {"setup": setup, **report.seconds}, record)


def build_scene(
    options: Options, bundle: Bundle, progress: Callable[[float], None] = lambda share: None
) -> tuple[Scene, tuple[str, ...]]:
    """The scene that the options describe, and what the user should know about it. progress: of growing a texture."""
    d = describe(options, bundle, progress)
    return scene_of(d), d.notes


def scene_of(d: Description) -> Scene:
    """What was described, ready for the renderer."""
    return Scene(
        mesh=d.mesh,
        shell=d.shell,
        ready=ready(d.material, d.origin),
        camera=d.camera,
        lights=d.lights,
        environment=d.environment,
        alpha=d.alpha,
        maps=d.maps,
        patches_per_uv=d.patches_per_uv,
        base_colour=d.base_colour,
        objects=d.objects,
        transparent=d.transparent,
    )


def facts(scene: Scene) -> Facts:
    """What the effects are planned from."""
    corners = bounding_box(scene.mesh)
    far = np.linalg.norm(np.abs(corners - scene.camera.to_world[:3, 3]).max(axis=0))
    patch = uv_stretch(scene.mesh) / scene.patches_per_uv
    footprint = pixel_radius(scene.camera.spread) / 2 * far / patch
    convex = is_convex(scene.mesh)
    ends = np.concatenate([scene.shell.base, scene.shell.base + scene.shell.offset])
    eye = scene.camera.to_world[:3, 3]
    return Facts(
        shells=1,
        objects=len(scene.objects),
        distant=len(scene.lights),
        environment=scene.environment is not None,
        seen=not scene.transparent,
        convex=convex,
        enclosed=0.0 if convex and not scene.objects else enclosure([scene.mesh, *scene.objects]),
        low=scene.environment is not None
        or lowest(scene.shell, np.array([x.direction for x in scene.lights]).reshape(-1, 3)) <= 0,
        ground=max(scene.base_colour),
        coarsest=float(2 * footprint * scene.ready.layout.texel_density),
        rows=scene.ready.layout.height_sizes[0][0],
        inside=bool(((ends.min(axis=0) <= eye) & (eye <= ends.max(axis=0))).all()),
        varying=tuple(scene.maps),
        shaped=scene.ready.layout.nodes is not None,
    )
