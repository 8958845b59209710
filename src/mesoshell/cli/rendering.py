"""The work of `mesoshell render`: options to scene, scene to files. Imports JAX, so it is loaded only when it runs.

Alphabet
diagonal    of the mesh's bounding box, world
stretch     world length of one UV unit, averaged over the surface
"""

import json
import sys
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mesoshell import __version__
from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.material import find, given
from mesoshell.cli.render import Options, parse_params
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, bounding_box, load_mesh, uv_stretch
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.image import read_exr, write_exr, write_png
from mesoshell.io.whole import replace_file
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.cone import pixel_radius
from mesoshell.render.effects import Effects, Facts, plan_effects
from mesoshell.render.light import Distant, Environment, environment
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.shell.extrude import extrude
from mesoshell.shell.grow import Wanted, field_of, grow, patches_of
from mesoshell.shell.renderer import Report, render
from mesoshell.shell.scene import Scene, normalised, ready

#: Fill light of the default lighting, and the light from below, as shares of the key light.
FILL, BOUNCE = 0.3, 0.12


def render_to_files(options: Options) -> None:
    """All of `mesoshell render`."""
    begin = time.perf_counter()
    out = options.out if options.out.suffix == ".png" else options.out.with_suffix(".png")
    compiled = keep_compiled()
    console = Console(stderr=True)
    quality = PRESETS[options.quality]
    bundle = read_bundle(find(options.material))
    columns = (TextColumn("growing"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        scene, notes = build_scene(options, bundle, lambda share: bar.update(task, completed=share))
    for note in notes:
        console.print(f"[dim]note:[/] {note}", highlight=False, soft_wrap=True)
    effects = plan_effects(facts(scene, quality), quality)
    if options.explain:
        for name, effect in vars(effects).items():
            line = f"{'on ' if effect.on else 'off'} {name.replace('_', ' ')}: {effect.why}"
            console.print(line, highlight=False, soft_wrap=True)
    setup = time.perf_counter() - begin
    columns = (TextColumn("rendering"), BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        image, report = render(scene, quality, effects, lambda share: bar.update(task, completed=share))
    seconds = {"setup": setup, **report.seconds, "total": time.perf_counter() - begin}
    record = as_json(options, bundle, report, effects, quality) | {"seconds": seconds, "compile_seconds": sum(compiled)}
    out.parent.mkdir(parents=True, exist_ok=True)
    write_png(out, image.astype(np.float32))
    write_exr(out.with_suffix(".exr"), image.astype(np.float32))
    replace_file(out.with_suffix(".json"), (json.dumps(record, indent=1) + "\n").encode())
    if options.explain:
        stages = ", ".join(f"{k} {v:.2f} s" for k, v in seconds.items())
        console.print(f"{stages}; {sum(compiled):.1f} s of this compiling", highlight=False)
    print(out, file=sys.stdout)


def build_scene(
    options: Options, bundle: Bundle, progress: Callable[[float], None] = lambda share: None
) -> tuple[Scene, list[str]]:
    """The scene that the options describe, and what the user should know about it. progress: of growing a texture."""
    for name, values in (("--irradiance", (options.irradiance,)), ("--base", options.base)):
        if not all(np.isfinite(v) and v >= 0 for v in values):
            raise InputError(name, "must be finite and not negative")
    mesh = load_mesh(options.mesh)
    box = bounding_box(mesh)
    thickness = float(np.linalg.norm(box[1] - box[0])) / 25 if options.thickness is None else options.thickness
    scale = 2 * thickness if options.scale is None else options.scale
    shell = extrude(mesh, thickness, scale)
    up = {"y": 1, "z": 2}[options.up or ("z" if options.mesh.suffix.lower() in (".ply", ".stl") else "y")]
    values, maps = given(bundle, options.param)
    patches = patches_per_uv(mesh, shell.uv)
    repeats = bool(mesh.uv.min() < 0 or mesh.uv.max() > 1)
    geometry = {p.name for p in bundle.parameters if p.role == "beta"} & maps.keys()
    fields = {name: field_of(maps.pop(name), (patches, patches), repeats) for name in geometry}
    wanted = Wanted(options.seed or 0, values, fields)
    material, origin, said = _grown(options, bundle, shell.uv, wanted, progress)
    camera = _camera(options, box, thickness, up)
    lights = tuple(_light(v, options.irradiance) for v in options.light)
    sky = _environment(options, up)
    if not lights and sky is None:
        lights = _default_lights(camera, up, options.irradiance)
    scene = Scene(
        mesh=mesh,
        shell=shell,
        ready=ready(material, origin),
        camera=camera,
        lights=lights,
        environment=sky,
        alpha=normalised(bundle, values),
        maps=maps,
        patches_per_uv=patches,
        base_colour=options.base,
        objects=tuple(load_mesh(p) for p in options.object),
        transparent=options.transparent,
    )
    return scene, [*mesh.notes, *shell.notes, *said]


def _grown(
    options: Options, bundle: Bundle, uv: np.ndarray, wanted: Wanted, progress: Callable[[float], None]
) -> tuple[Bundle, tuple[int, int], list[str]]:
    """The material with a texture for this surface, where the texture begins, and what the user should know."""
    asked = wanted.values.keys() | wanted.fields.keys()
    fixed = [p.name for p in bundle.parameters if p.role == "beta" and p.name in asked]
    if bundle.generator is not None and (not bundle.baked or options.seed is not None or fixed):
        return *grow(bundle, options.material, uv.reshape(-1, 3, 2), wanted, progress), []
    if options.seed is not None:
        raise InputError("--seed", f"{options.material} is one texture and has no generator")
    if fixed:
        raise InputError("--param", f"{fixed[0]} is baked into {options.material}, which has no generator")
    if bundle.wraps:
        return bundle, (0, 0), []
    (u, v), needed = patches_of(uv.reshape(-1, 3, 2))
    texels = bundle.texel_density
    height, width = (n / texels for n in bundle.arrays["features/0"].shape[:2])
    small = needed.shape[1] > width + 2 or needed.shape[0] > height + 2
    said = f"the mesh spans about {needed.shape[1]} × {needed.shape[0]} patches, the texture {width:g} × {height:g}: "
    return bundle, (u, v), [said + "its last texels repeat beyond its edges"] if small else []


def patches_per_uv(mesh: Mesh, patches: np.ndarray) -> float:
    """Texture patches along one UV unit: the ratio that extrusion has applied."""
    size = float(np.abs(mesh.uv).max())
    return float(np.abs(patches).max()) / size if size > 0 else 1.0


def facts(scene: Scene, quality: Quality) -> Facts:
    """What the effects are planned from."""
    corners = bounding_box(scene.mesh)
    far = np.linalg.norm(np.abs(corners - scene.camera.to_world[:3, 3]).max(axis=0))
    patch = uv_stretch(scene.mesh) / scene.patches_per_uv
    footprint = pixel_radius(scene.camera.spread) / 2 * far / patch
    return Facts(
        lights=len(scene.lights),
        environment=scene.environment is not None,
        objects=len(scene.objects),
        convex=is_convex(scene.mesh),
        coarsest=float(2 * footprint * scene.ready.layout.texel_density),
        varying=tuple(scene.maps),
        transparent=scene.transparent,
    )


def is_convex(mesh: Mesh) -> bool:
    """Whether no vertex lies in front of any face: such a mesh shadows nothing of itself but by facing away."""
    v = mesh.vertices.astype(np.float64)
    size = np.ptp(v, axis=0).max()
    for f in mesh.faces:
        normal = np.cross(v[f[1]] - v[f[0]], v[f[2]] - v[f[0]])
        if ((v - v[f[0]]) @ normal).max() > 1e-6 * size * np.linalg.norm(normal):
            return False
    return True


def _camera(options: Options, box: np.ndarray, thickness: float, up: int) -> Camera:
    width, height = options.size
    if width < 1 or height < 1:
        raise InputError("--size", f"{width} x {height} has no pixels")
    axis = (0.0, 1.0, 0.0) if up == 1 else (0.0, 0.0, 1.0)
    if options.camera is not None:
        eye, target, degrees = options.camera[:3], options.camera[3:6], options.camera[6]
        if not np.isfinite(options.camera).all():
            raise InputError("--camera", "holds a number that is not finite")
        if not 0 < degrees < 180:
            raise InputError("--camera", f"a field of view of {degrees:g} degrees is not between 0 and 180")
        if eye == target:
            raise InputError("--camera", "eye and target are the same point")
        return Camera(look_at(eye, target, axis), np.radians(degrees), width, height)
    fov = np.radians(35.0)
    centre, radius = box.mean(axis=0), np.linalg.norm(box[1] - box[0]) / 2 + thickness
    narrow = 2 * np.arctan(np.tan(fov / 2) * min(1.0, width / height))
    front = np.array([0.55, 0.4, 0.75]) if up == 1 else np.array([0.55, -0.75, 0.4])
    eye = centre + front / np.linalg.norm(front) * radius / np.sin(narrow / 2) * 0.92
    return Camera(look_at(tuple(eye), tuple(centre), axis), float(fov), width, height)


def _light(direction: tuple[float, float, float], irradiance: float) -> Distant:
    length = float(np.linalg.norm(direction))
    if not (np.isfinite(length) and length > 0):
        raise InputError("--light", f"{direction} is no direction")
    return Distant(np.array(direction) / length, np.full(3, irradiance))


def _default_lights(camera: Camera, up: int, irradiance: float) -> tuple[Distant, ...]:
    """A key light over the camera's left shoulder, a weak fill from its right, and a weaker bounce from below."""
    right, back, above = camera.to_world[:3, 0], camera.to_world[:3, 2], np.eye(3)[up]
    lights = (
        (1.1 * above - 0.7 * right + 0.5 * back, (1.0, 0.96, 0.9), 1.0),
        (0.4 * above + right + 0.6 * back, (0.8, 0.9, 1.0), FILL),
        (0.4 * back - above, (0.9, 0.95, 0.85), BOUNCE),
    )
    return tuple(Distant(v / np.linalg.norm(v), np.array(c) * share * irradiance) for v, c, share in lights)


def _environment(options: Options, up: int) -> Environment | None:
    if options.environment is None:
        return None
    image = read_exr(options.environment)[..., :3]
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() > 0):
        raise InputError(options.environment, "holds negative, infinite or no light")
    return environment(image, up)


def as_json(options: Options, bundle: Bundle, report: Report, effects: Effects, quality: Quality) -> dict:
    """The report beside the picture, without its seconds."""
    counts = report.counts
    queries = sum(counts.get(k, 0) for k in ("density_queries", "transport_queries", "surface_queries"))
    return {
        "version": __version__,
        "engine": "jax",
        "rays": counts.get("rays", 0),
        "queries": queries,
        "counts": counts,
        "effects": effects.as_dict(),
        "quality": quality.as_dict(),
        "material": {"name": options.material, "parameters": parse_params(options.param), **bundle.provenance},
    }
