"""Check a scene as the hard cases do (docs/results/stability.md), and say where it is hard.

Of several materials, each one's mesh, shell and network are checked by themselves, and rays are walked through all shells
together; lengths are in the thickness of the thinnest. A surface material has no shell to walk: its hits are checked.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.io.surface import KIND
from mesoshell.limits import check_memory
from mesoshell.render.camera import Camera
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS
from mesoshell.scene.growth import Growth, thickness_and_scale
from mesoshell.scene.prepare import check_engine, prepare
from mesoshell.scene.render_shell import facts, marched_scene
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.setup import describe_shell, describe_surface, with_distant_lamps
from mesoshell.shell.render.renderer import render
from mesoshell.stability import surface
from mesoshell.stability.checks import Check
from mesoshell.stability.field import check_material_points
from mesoshell.stability.report import Stability
from mesoshell.stability.walks import walk_through
from mesoshell.surface_material.scene import SurfaceDescription, SurfacePart

#: Pixels along the longer side of the picture, and of the map; least number of rays; most that the path tracer walks.
PIXELS, MIN_RAYS, MAX_WALKED = 192, 1000, 20_000


def examine(
    scene: Scene, count: int, progress: Callable[[float], None] = lambda share: None, engine: str = "jax"
) -> Stability:
    """Check a scene. count: rays that are aimed at what is hard; progress: called with the share done, 0 to 1; engine: that
    renders the picture; if "mitsuba", its walk of shells is checked too. Raises InputError."""
    if count < MIN_RAYS:
        raise InputError(Argument("rays"), f"must be at least {MIN_RAYS}, not {count}")
    check_memory(Argument("rays"), f"{count} rays", 4000 * count)
    if scene.material.kind == KIND:
        return _of_surface_material(scene, count, progress, engine)
    check_engine(scene, engine)
    if engine == "mitsuba":
        from mesoshell.stability.paths import of_walk
    d = describe_shell(scene, lambda share: progress(0.2 * share))
    d, lamps = with_distant_lamps(d, [x.mesh for x in d.growths])
    grown = [scene, *(part for part in scene.also if part.material.kind != KIND)]
    each = [thickness_and_scale(one, x.mesh)[0] for one, x in zip(grown, d.growths, strict=True)]
    called = [one.called if isinstance(one, Grown) else one.material.name for one in grown]
    names = [f"{name}: " if len(grown) > 1 else "" for name in called]
    made = marched_scene(replace(d, camera=_smaller(d.camera)))
    rng = np.random.default_rng(0)
    kept = [_lengths(x) / own for x, own in zip(d.growths, each, strict=True)]
    checks = [
        replace(check, said=name + check.said)
        for name, x, own in zip(names, d.growths, each, strict=True)
        for check in (
            surface.of_mesh(x.mesh),
            surface.of_grid(x.shell.base, own),
            surface.of_folds(x.shell),
            surface.of_thickness(x.shell, own, len(x.mesh.faces)),
            surface.of_chart(x.shell),
            surface.of_sides(x.shell, rng),
        )
    ]
    thickness = min(each)
    walks = walk_through(made, thickness, count, rng, lambda share: progress(0.2 + 0.5 * share))
    checks += walks.checks
    ends = [*(m.prism for m in made.media), len(made.shell.faces)]
    for name, medium, (first, end) in zip(names, made.media, pairwise(ends), strict=True):
        own = check_material_points(medium, made.shell.uv[first:end], rng)
        checks += [replace(check, said=name + check.said) for check in own]
    for part, one in zip(d.surfaces, (x for x in scene.also if x.material.kind == KIND), strict=True):
        checks += [
            replace(check, said=f"{one.called}: {check.said}") for check in _of_part(part, made.camera, count, rng)
        ]
    progress(0.8)
    quality = PRESETS["normal"]
    if engine == "mitsuba":
        checks.append(of_walk(made, thickness, min(count, MAX_WALKED), rng))
        seen = replace(scene, camera=made.camera, size=(made.camera.width, made.camera.height))
        picture = prepare(seen, quality.with_changes(twin=0.0), engine).picture().rgba
    else:
        picture = render(made, quality, plan_effects(facts(made), quality))[0]
    checks.append(_of_radiance(picture))
    progress(1.0)
    return Stability(
        tuple(checks),
        picture,
        walks.first,
        np.concatenate(kept),
        walks.excess,
        (*d.notes, *(lamps if engine == "jax" else ())),
    )


def _of_part(part: SurfacePart, camera: Camera, count: int, rng: np.random.Generator) -> list[Check]:
    """Of a surface material beside shells."""
    from mesoshell.stability.surface_material import of_surface_material
    from mesoshell.surface_material.loader import load_device_material

    d = SurfaceDescription(part.mesh, part.period, camera, (), None, (0.0, 0.0, 0.0), (), True)
    return list(of_surface_material(d, load_device_material(part.material), camera, count, rng)[0])


def _of_surface_material(scene: Scene, count: int, progress: Callable[[float], None], engine: str) -> Stability:
    from mesoshell.stability.surface_material import of_surface_material
    from mesoshell.surface_material.loader import load_device_material

    d = describe_surface(scene)
    camera = _smaller(d.camera)
    seen = replace(scene, camera=camera, size=(camera.width, camera.height))
    made = prepare(seen, PRESETS["normal"], engine).picture(lambda share: progress(0.5 * share))
    rng = np.random.default_rng(0)
    checks, first, excess = of_surface_material(d, load_device_material(scene.material.surface), camera, count, rng)
    progress(1.0)
    return Stability((*checks, _of_radiance(made.rgba)), made.rgba, first, None, excess, made.notes)


def _of_radiance(picture: Float[np.ndarray, "H W 4"]) -> Check:
    wrong = ~np.isfinite(picture).all(axis=2) | (picture < 0).any(axis=2)
    brightest = np.max(picture[..., :3], where=np.isfinite(picture[..., :3]), initial=0)
    line = f"{wrong.sum()} of {wrong.size} pixels are negative or not finite; the brightest is {brightest:.3g}"
    return Check("radiance", line, float(wrong.sum()), 0.0)


def _lengths(x: Growth) -> Float[np.ndarray, "P"]:
    """How thick a shell is over each face (world)."""
    return np.linalg.norm(x.shell.offset.astype(np.float64), axis=1)[x.shell.faces].mean(axis=1)


def _smaller(camera: Camera) -> Camera:
    """The same view in at most PIXELS along the longer side."""
    less = min(1.0, PIXELS / max(camera.width, camera.height))
    return replace(camera, width=max(1, round(less * camera.width)), height=max(1, round(less * camera.height)))
