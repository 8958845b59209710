"""Pictures by path tracing in Mitsuba: a mesh that the options describe, or a scene of Mitsuba's own."""

import time
from dataclasses import MISSING, fields
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.description import Description, describe, describe_surface
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects, say_notes
from mesoshell.cli.standing import in_place, twin_facts
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import is_convex
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.io.surface import KIND, SurfaceBundle, kind_of, read_surface
from mesoshell.limits import check_memory
from mesoshell.pathtracer import assemble, integrator, load_file
from mesoshell.pathtracer.load import Grown, stand_on
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Medium
from mesoshell.pathtracer.worn import SurfaceMaterial
from mesoshell.render.effects import PATHS, plan_twin
from mesoshell.render.facts import TwinFacts
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.render.used import quality_used
from mesoshell.silhouette.scene import SurfaceDescription
from mesoshell.silhouette.wear import wear

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer, which names a libLLVM that works)

#: Paths that are traced at once: what is in memory.
LANES = 2**22
#: Options that a scene of Mitsuba's leaves a meaning.
_OF_SCENES = {"mesh", "engine", "spp", "quality", "explain", "out"}


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    given = {name: getattr(options, name) for name in ("spp", "max_depth") if getattr(options, name) is not None}
    quality = PRESETS[options.quality].with_changes(**given)
    if options.mesh.suffix.lower() == ".xml":
        for field in fields(Options):
            default = field.default_factory() if field.default_factory is not MISSING else field.default
            if field.name not in _OF_SCENES and getattr(options, field.name) != default:
                raise InputError(f"--{field.name.replace('_', '-')}", f"{options.mesh} says that itself")
        scene, provenance = load_file(options.mesh, quality), {}
        _check_sensor(scene, options)
        samples = options.spp or scene.sensors()[0].sampler().sample_count()
    else:
        scene, provenance = _scene(options, quality, console)
        samples = quality.spp
    world = getattr(scene.integrator(), "world", None)
    say_notes(console, () if world is None else world.notes)
    if options.explain and world is not None:
        say_effects(console, world.effects.as_dict())
    setup = time.perf_counter() - begin
    begin = time.perf_counter()
    image, rays = _rendered(scene, samples, console)
    queries = 0 if world is None else world.queries
    record = {
        "rays": rays,
        "queries": queries,
        "effects": {} if world is None else world.effects.as_dict(),
        "quality": {} if world is None else quality_used(world.quality.with_changes(spp=samples), world.effects, PATHS),
    }
    return Picture(image, {"setup": setup, "render": time.perf_counter() - begin}, record | {"provenance": provenance})


def _check_sensor(scene: mi.Scene, options: Options) -> None:
    """Raise InputError for a scene of nothing to be seen by, or of a film that memory does not hold."""
    if not scene.sensors():
        raise InputError(options.mesh, "has no sensor")
    width, height = (int(x) for x in scene.sensors()[0].film().crop_size())
    if not width * height:
        raise InputError(options.mesh, f"its film of {width} x {height} has no pixels")
    if not (options.spp or scene.sensors()[0].sampler().sample_count()):
        raise InputError(options.mesh, "its sampler takes no samples: give sample_count, or --spp")
    check_memory(options.mesh, f"its film of {width} x {height}", 64 * width * height)


def _scene(options: Options, quality: Quality, console: Console) -> tuple[mi.Scene, dict[str, Any]]:
    """A scene of Mitsuba's with what the options describe, and the material's provenance."""
    if kind_of(find(options.material)) == KIND:
        material, d = read_surface(find(options.material)), describe_surface(options)
        return _dressed(options, d, material, quality, console), material.provenance
    bundle = read_bundle(find(options.material))
    d = describe(options, bundle)
    say_notes(console, d.notes)
    found = twin_facts(options, bundle, d, quality)
    if bundle.twin is not None and plan_twin(found, quality).on:
        return _dressed(options, in_place(d), bundle.twin.surface, quality, console, found), bundle.provenance
    scene = mi.load_dict(_parts(quality, d) | {"surface": assemble.surface(d.mesh, d.base_colour)})
    names = [p.name for p in bundle.parameters if p.role == "alpha"]
    maps = {name: assemble.over_uv(image) for name, image in d.maps.items()}
    alpha = tuple(maps.get(name, float(v)) for name, v in zip(names, d.alpha, strict=True))
    medium = Medium(Material(d.material, d.origin), alpha, d.patches_per_uv)
    stand_on(scene, Grown([(d.shell, medium)], convex=is_convex(d.mesh), twin=found), quality)
    return scene, bundle.provenance


def _dressed(
    options: Options,
    d: SurfaceDescription,
    bundle: SurfaceBundle,
    quality: Quality,
    console: Console,
    twin: TwinFacts | None = None,
) -> mi.Scene:
    """The same of a mesh that wears a surface material."""
    worn = wear(d.mesh, d.period, quality)
    say_notes(console, (*d.mesh.notes, *worn.notes(bundle.curvature)))
    scene = mi.load_dict(_parts(quality, d))
    grown = Grown([], [(worn, SurfaceMaterial(bundle))], convex=is_convex(d.mesh), twin=twin)
    stand_on(scene, grown, quality)
    return scene


def _parts(quality: Quality, d: Description | SurfaceDescription) -> dict[str, Any]:
    """Camera, lights and objects of what the options describe."""
    integrator.register()
    depths = {"max_depth": quality.max_depth, "rr_depth": quality.rr_depth}
    parts: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "mesoshell_path", "hide_emitters": d.transparent, **depths},
        "sensor": assemble.sensor(d.camera, quality.spp),
    }
    parts |= {f"light{i}": assemble.distant(light) for i, light in enumerate(d.lights)}
    parts |= {f"object{i}": assemble.surface(mesh, d.base_colour) for i, mesh in enumerate(d.objects)}
    return parts if d.environment is None else parts | {"sky": assemble.sky(d.environment)}


def _rendered(scene: mi.Scene, samples: int, console: Console) -> tuple[np.ndarray, int]:
    """The picture, RGBA, as the mean of passes that fit in memory; and how many camera rays it took."""
    width, height = (int(x) for x in scene.sensors()[0].film().crop_size())
    each = max(1, min(samples, LANES // (width * height)))
    counts = [min(each, samples - k) for k in range(0, samples, each)]
    total = np.zeros((height, width, 4))
    columns = (TextColumn("rendering"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=samples)
        for seed, count in enumerate(counts):
            found = np.array(mi.render(scene, spp=count, seed=mi.UInt32(seed)))
            if found.shape[-1] == 3:
                found = np.concatenate([found, np.ones_like(found[..., :1])], axis=-1)
            total += count / samples * found[..., :4]
            bar.advance(task, count)
    return total.astype(np.float32), width * height * samples
