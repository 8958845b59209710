"""Pictures by path tracing in Mitsuba: a mesh that the options describe, or a scene of Mitsuba's own."""

import time
from dataclasses import MISSING, fields
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell.cli.description import Description, describe, describe_surface
from mesoshell.cli.render import Options
from mesoshell.cli.rendering import Picture, say_effects
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
from mesoshell.render.effects import plan_twin
from mesoshell.render.quality import PRESETS
from mesoshell.silhouette.scene import SurfaceDescription
from mesoshell.silhouette.wear import wear

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer, which names a libLLVM that works)

#: Paths that are traced at once: what is in memory.
LANES = 2**22
SAMPLES, DEPTH = 64, 8
#: Options that a scene of Mitsuba's leaves a meaning.
_OF_SCENES = {"mesh", "engine", "spp", "quality", "explain", "out"}


def picture(options: Options, console: Console) -> Picture:
    """What the options ask for, rendered; says on the console what the user should know."""
    begin = time.perf_counter()
    if options.mesh.suffix.lower() == ".xml":
        for field in fields(Options):
            default = field.default_factory() if field.default_factory is not MISSING else field.default
            if field.name not in _OF_SCENES and getattr(options, field.name) != default:
                raise InputError(f"--{field.name.replace('_', '-')}", f"{options.mesh} says that itself")
        scene, provenance, effects = load_file(options.mesh, PRESETS[options.quality]), {}, {}
        _check_sensor(scene, options)
        samples = options.spp or scene.sensors()[0].sampler().sample_count()
    else:
        scene, provenance, effects = _scene(options, console)
        samples = options.spp or SAMPLES
    world = getattr(scene.integrator(), "world", None)
    effects |= {} if world is None else world.effects.as_dict()
    _say(console, () if world is None else world.notes)
    if options.explain:
        say_effects(console, effects)
    setup = time.perf_counter() - begin
    begin = time.perf_counter()
    image, rays = _rendered(scene, samples, console)
    queries = 0 if world is None else world.queries
    record = {
        "rays": rays,
        "queries": queries,
        "samples": samples,
        "effects": effects,
        "quality": PRESETS[options.quality].as_dict(),
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


def _say(console: Console, notes: tuple[str, ...]) -> None:
    for note in notes:
        console.print(f"[dim]note:[/] {note}", highlight=False, soft_wrap=True)


def _scene(options: Options, console: Console) -> tuple[mi.Scene, dict[str, Any], dict[str, Any]]:
    """A scene of Mitsuba's with what the options describe, the material's provenance, and what was decided before."""
    quality = PRESETS[options.quality]
    if kind_of(find(options.material)) == KIND:
        material, d = read_surface(find(options.material)), describe_surface(options)
        return _dressed(options, d, material, console), material.provenance, {}
    bundle = read_bundle(find(options.material))
    d = describe(options, bundle)
    _say(console, d.notes)
    twin = plan_twin(twin_facts(options, bundle, d, quality), quality)
    decided = {"twin": vars(twin)}
    if bundle.twin is not None and twin.on:
        return _dressed(options, in_place(d), bundle.twin.surface, console), bundle.provenance, decided
    scene = mi.load_dict(_parts(options, d) | {"surface": assemble.surface(d.mesh, d.base_colour)})
    names = [p.name for p in bundle.parameters if p.role == "alpha"]
    maps = {name: assemble.over_uv(image) for name, image in d.maps.items()}
    alpha = tuple(maps.get(name, float(v)) for name, v in zip(names, d.alpha, strict=True))
    medium = Medium(Material(d.material, d.origin), alpha, d.patches_per_uv)
    stand_on(scene, Grown([(d.shell, medium)], alone=is_convex(d.mesh)), quality)
    return scene, bundle.provenance, decided


def _dressed(options: Options, d: SurfaceDescription, bundle: SurfaceBundle, console: Console) -> mi.Scene:
    """The same of a mesh that wears a surface material."""
    quality = PRESETS[options.quality]
    worn = wear(d.mesh, d.period, quality)
    _say(console, (*d.mesh.notes, *worn.notes(bundle.curvature)))
    scene = mi.load_dict(_parts(options, d))
    stand_on(scene, Grown([], [(worn, SurfaceMaterial(bundle))]), quality)
    return scene


def _parts(options: Options, d: Description | SurfaceDescription) -> dict[str, Any]:
    """Camera, lights and objects of what the options describe."""
    integrator.register()
    depth = DEPTH if options.max_depth is None else options.max_depth
    parts: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "mesoshell_path", "max_depth": depth, "hide_emitters": d.transparent},
        "sensor": assemble.sensor(d.camera, options.spp or SAMPLES),
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
