"""Walk a scene with the checks that the hard cases test (docs/results/stability.md), and say where it is hard."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS
from mesoshell.scene.prepare import prepare
from mesoshell.scene.render_shell import facts, marched_scene
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.geometry.extrude import proportions
from mesoshell.shell.render.renderer import render
from mesoshell.stability import surface
from mesoshell.stability.checks import Check
from mesoshell.stability.field import of_material
from mesoshell.stability.report import Stability
from mesoshell.stability.walks import walk_through

#: Pixels along the longer side of the picture, and of the map; least number of rays; most that the path tracer walks.
PIXELS, LEAST, WALKED = 192, 1000, 20_000


def examine(
    scene: Scene, count: int, progress: Callable[[float], None] = lambda share: None, engine: str = "jax"
) -> Stability:
    """Check a scene with a neural shell. count: rays that are aimed at what is hard; progress: called with the share done, 0 to
    1; engine: that renders the picture; if "mitsuba", its walk is checked too. Raises InputError."""
    if scene.material.kind == KIND:
        raise InputError(Argument("material"), f"{scene.material.name} is a surface material: it has no shell to walk")
    if scene.also:
        raise InputError(Argument("also"), "is not checked: examine one material at a time")
    if count < LEAST:
        raise InputError(Argument("rays"), f"must be at least {LEAST}, not {count}")
    if engine == "mitsuba":
        if scene.holdout:
            raise InputError(Argument("holdout"), "objects are held out by `engine` jax alone")
        from mesoshell.stability.paths import of_walk
    d = describe_shell(scene, lambda share: progress(0.2 * share))
    thickness = proportions(d.mesh, d.material.thickness, scene.thickness, scene.scale)[0]
    made = marched_scene(replace(d, camera=_smaller(d.camera)))
    rng = np.random.default_rng(0)
    kept = np.linalg.norm(d.shell.offset.astype(np.float64), axis=1)[d.shell.faces].mean(axis=1) / thickness
    checks = [
        surface.of_mesh(d.mesh),
        surface.of_grid(d.shell, thickness),
        surface.of_folds(d.shell),
        surface.of_thickness(d.shell, thickness, len(d.mesh.faces)),
        surface.of_chart(d.shell),
        surface.of_sides(d.shell, rng),
    ]
    walks = walk_through(made, thickness, count, rng, lambda share: progress(0.2 + 0.5 * share))
    checks += walks.checks
    checks += of_material(made, rng)
    progress(0.8)
    quality = PRESETS["normal"]
    if engine == "mitsuba":
        checks.append(of_walk(made, thickness, min(count, WALKED), rng))
        seen = replace(scene, camera=made.camera, size=(made.camera.width, made.camera.height))
        picture = prepare(seen, quality.with_changes(twin=0.0), engine).picture().rgba
    else:
        picture = render(made, quality, plan_effects(facts(made), quality))[0]
    wrong = ~np.isfinite(picture).all(axis=2) | (picture < 0).any(axis=2)
    brightest = np.max(picture[..., :3], where=np.isfinite(picture[..., :3]), initial=0)
    line = f"{wrong.sum()} of {wrong.size} pixels are negative or not finite; the brightest is {brightest:.3g}"
    checks.append(Check("radiance", line, float(wrong.sum()), 0.0))
    progress(1.0)
    return Stability(tuple(checks), picture, walks.first, kept, walks.excess, d.notes)


def _smaller(camera: Camera) -> Camera:
    """The same view in at most PIXELS along the longer side."""
    less = min(1.0, PIXELS / max(camera.width, camera.height))
    return replace(camera, width=max(1, round(less * camera.width)), height=max(1, round(less * camera.height)))
