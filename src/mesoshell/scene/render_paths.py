"""Render by path tracing in Mitsuba: a scene, or an XML file of Mitsuba's (loads JAX only to grow a texture)."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.convex import is_convex
from mesoshell.io.surface import KIND, SurfaceBundle
from mesoshell.limits import check_memory
from mesoshell.pathtracer import integrator, scene_dict
from mesoshell.pathtracer.load import SceneShells, load_sized, set_quality, set_shells
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Medium
from mesoshell.pathtracer.passes import as_rgba, can_pass, render_pass
from mesoshell.pathtracer.surface_material import SurfaceMaterial
from mesoshell.render.camera import Camera
from mesoshell.render.effects import PATHS, plan_twin
from mesoshell.render.facts import TwinFacts
from mesoshell.render.mitsuba_frame import camera_pose, fitting_grid, near_clip
from mesoshell.render.quality import Quality
from mesoshell.render.used import quality_used
from mesoshell.scene.growth import Growth
from mesoshell.scene.lod import describe_twin, twin_facts
from mesoshell.scene.picture import Passes, Prepared, Progress, Rendered
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import ShellDescription, check_size, describe_shell, describe_surface
from mesoshell.shell.geometry.extrude import is_even
from mesoshell.surface_material.scene import SurfaceDescription
from mesoshell.surface_material.tables import SurfaceTables, surface_tables

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer, which names a libLLVM that works)

#: Paths traced at once, which bounds memory.
LANES = 2**22


def prepare_paths(scene: Scene, quality: Quality, begun: float, progress: Progress) -> Prepared:
    """The scene, ready for Mitsuba. progress: of growing a texture. Raises InputError."""
    made, notes = _made(scene, quality, progress)
    context = _context(made)
    assert context is not None
    work = _work(made, quality.spp), lambda other: _passes(made, other or quality)
    return Prepared.now(scene, PATHS.name, context.effects, (*notes, *context.notes), begun, *work)


def prepare_file(
    path: Path,
    quality: Quality,
    samples: int | None,
    names: Mapping[str, str] | None = None,
    size: tuple[int, int] | None = None,
    pixels: int | None = None,
) -> Prepared:
    """A scene of Mitsuba's XML, ready. samples: paths a pixel; None: as many as the file says. names: values of its `$name`s.
    size: of its film; None: its own. pixels: that its film gets at most, in its own proportions. Raises InputError."""
    begun = time.perf_counter()
    if size is not None:
        check_size(Argument("size"), size)
    made = load_sized(path, quality, size, names or {})
    samples = _samples(made, path, samples)
    if pixels is not None:
        _shrink(made, pixels)
    context = _context(made)
    effects, notes = (None, ()) if context is None else (context.effects, context.notes)
    own: Any = made.integrator()
    depths = {} if context is None else {"max_depth": max(own.max_depth, 1), "rr_depth": max(own.rr_depth, 1)}
    work = _work(made, samples), lambda other: _passes(made, (other or quality).with_changes(**depths))
    return Prepared(PATHS.name, {}, effects, notes, begun, time.perf_counter() - begun, *work)


class MovedFile:
    """A scene of Mitsuba's XML that is seen from anywhere. camera: as its first sensor; distance: to what that shows; notes:
    what the user should know, a line each; effects: None for another integrator than ours. Raises InputError as `prepare_file`,
    and for a sensor that is no perspective one."""

    def __init__(self, path: Path, quality: Quality, names: Mapping[str, str] | None = None):
        self._scene = load_sized(path, quality, None, names or {}, anywhere=True)
        _samples(self._scene, path, 1)
        sensor = self._scene.sensors()[0]
        self._sensor = mi.traverse(sensor)
        if "x_fov" not in self._sensor or "to_world" not in self._sensor:
            raise InputError(path, "its first sensor is no perspective one, which alone can be moved")
        width, height = (int(x) for x in sensor.film().crop_size())
        if tuple(sensor.film().size()) != (width, height):
            raise InputError(path, "its film is cropped: it cannot be given the size of a window")
        pose = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
        pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
        fov = 2 * np.arctan(np.tan(np.radians(float(np.array(self._sensor["x_fov"]).item())) / 2) * height / width)
        self.camera = Camera(pose @ np.diag([-1.0, 1, -1, 1]), float(fov), width, height)
        context = _context(self._scene)
        self.effects, self.notes = (None, ()) if context is None else (context.effects, context.notes)
        self._seen: tuple[Camera | None, Quality | None] = None, None
        eye, ahead = self.camera.to_world[:3, 3], -self.camera.to_world[:3, 2]
        met = self._scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(eye.tolist()), mi.Vector3f(ahead.tolist())))
        away, box = float(np.array(met.t).item()), self._scene.bbox()
        middle = np.array(box.center(), np.float64).ravel() if box.valid() else eye + ahead
        self.distance = away if np.isfinite(away) else max(float((middle - eye) @ ahead), 1e-3)

    def passes(self, camera: Camera, quality: Quality) -> Passes:
        """Passes of a path a pixel, as a camera sees it, with the depths of paths that the file says. Passes of several cameras
        may take turns."""
        own: Any = self._scene.integrator()
        ours = _context(self._scene) is not None
        depths = {"max_depth": max(own.max_depth, 1), "rr_depth": max(own.rr_depth, 1)} if ours else {}
        quality = quality.with_changes(density="network", **depths)
        self._see(camera, quality)
        made = _passes(self._scene, quality)

        def render(k: int, pixels: np.ndarray, progress: Progress) -> np.ndarray:
            self._see(camera, quality)
            return made.render(k, pixels, progress)

        return made._replace(render=render)

    def _see(self, camera: Camera, quality: Quality) -> None:
        """Look through a camera from now on."""
        if self._seen[0] is camera and self._seen[1] is quality:
            return
        self._seen = camera, quality
        self._sensor["to_world"] = mi.ScalarTransform4f(camera_pose(camera))
        self._sensor["x_fov"] = float(np.degrees(2 * np.arctan(np.tan(camera.fov / 2) * camera.width / camera.height)))
        self._sensor["film.size"] = mi.ScalarVector2u(camera.width, camera.height)
        self._sensor.update()
        set_quality(self._scene, quality)


def _context(scene: mi.Scene) -> Any:
    """Our integrator's context: what paths meet beside surfaces. None for another integrator."""
    return getattr(scene.integrator(), "context", None)


def _work(scene: mi.Scene, samples: int) -> Callable[[Progress], Rendered]:
    def work(progress: Progress) -> Rendered:
        baking, begin = _bake(scene), time.perf_counter()
        image, rays = _rendered(scene, samples, progress)
        seconds = baking | {"render": time.perf_counter() - begin}
        return Rendered(image, seconds, _record(scene, samples, rays))

    return work


def _bake(scene: mi.Scene) -> dict[str, float]:
    """Make grids of density, if paths read them. The seconds that it took."""
    context, begin = _context(scene), time.perf_counter()
    if context is None or not context.effects.baked_density.on:
        return {}
    context.bake()
    return {"bake": time.perf_counter() - begin}


def _record(scene: mi.Scene, samples: int, rays: int) -> dict[str, Any]:
    """The engine's part of the report."""
    context = _context(scene)
    if context is None:
        return {"rays": rays, "queries": 0, "effects": {}, "quality": {"spp": samples}}
    used = quality_used(context.quality.with_changes(spp=samples), context.effects, PATHS)
    return {"rays": rays, "queries": context.queries, "effects": context.effects.as_dict(), "quality": used}


def _passes(scene: mi.Scene, quality: Quality) -> Passes:
    """Passes of a path a pixel. Pixels can be left out where each has its own samples alone."""
    set_quality(scene, quality)
    baking = _bake(scene)
    film, begin, rays = scene.sensors()[0].film(), time.perf_counter(), 0
    width, height = (int(x) for x in film.crop_size())
    ours = _context(scene) is not None and can_pass(film)
    chosen = ours and film.rfilter().is_box_filter()

    def render_one(k: int, pixels: np.ndarray, progress: Progress) -> np.ndarray:
        nonlocal rays
        image = render_pass(scene, pixels, k) if ours else _image(scene, 1, k).reshape(-1, 4)[pixels]
        rays += len(pixels)
        progress(1.0)
        return image

    def ended(image: np.ndarray, samples: int) -> Rendered:
        return Rendered(image, baking | {"render": time.perf_counter() - begin}, _record(scene, samples, rays))

    return Passes((height, width), chosen, lambda pixels: 1, render_one, ended)


def _shrink(scene: mi.Scene, pixels: int) -> None:
    """Give the film so many pixels at most, and all of its view; one that is cropped stays as it is."""
    film = scene.sensors()[0].film()
    width, height = (int(x) for x in film.size())
    less = (pixels / (width * height)) ** 0.5
    if less >= 1 or tuple(film.crop_size()) != (width, height):
        return
    parameters = mi.traverse(scene.sensors()[0])
    parameters["film.size"] = mi.ScalarVector2u(max(1, int(less * width)), max(1, int(less * height)))
    parameters.update()
    context = _context(scene)
    if context is not None:  # footprints grow as pixels do
        facts = context.facts
        context.facts = replace(facts, coarsest=facts.coarsest / less, magnified=facts.magnified * less)


def _samples(scene: mi.Scene, path: Path, samples: int | None) -> int:
    """Paths a pixel. Raises InputError for a scene without a sensor, or a film that memory does not hold."""
    if not scene.sensors():
        raise InputError(path, "has no sensor")
    width, height = (int(x) for x in scene.sensors()[0].film().crop_size())
    if not width * height:
        raise InputError(path, f"its film of {width} x {height} has no pixels")
    samples = samples or scene.sensors()[0].sampler().sample_count()
    if not samples:
        raise InputError(path, "its sampler takes no samples: give sample_count, or `spp`")
    check_memory(path, f"its film of {width} x {height}", 64 * width * height)
    return samples


def _made(scene: Scene, quality: Quality, progress: Progress) -> tuple[mi.Scene, tuple[str, ...]]:
    """The scene as Mitsuba's, and what the user should know."""
    if scene.material.kind == KIND:
        d = describe_surface(scene)
        return _made_surface(d, scene.material.surface, quality, d.mesh.notes)
    d, bundle = describe_shell(scene, progress), scene.material.shell
    twin = twin_facts(scene, d, quality)
    if bundle.twin is not None and plan_twin(twin, quality).on:
        return _made_surface(describe_twin(d), bundle.twin.surface, quality, d.notes, twin)
    grounds = {f"surface{i}": scene_dict.surface(x.mesh, d.base_colour) for i, x in enumerate(d.growths)}
    made = mi.load_dict(_parts(quality, d) | grounds)
    materials: dict[tuple, Material] = {}
    shells = [(x.shell, _medium(x, materials)) for x in d.growths]
    convex = all(is_even(x.mesh, x.shell) and is_convex(x.mesh) for x in d.growths)
    surfaces, notes = _surfaces(d, quality)
    convex &= all(is_convex(x.mesh) for x in d.surfaces)
    set_shells(made, SceneShells(shells, surfaces, convex=convex, twin=twin), quality)
    return made, (*d.notes, *notes)


def _surfaces(
    d: ShellDescription, quality: Quality
) -> tuple[list[tuple[SurfaceTables, SurfaceMaterial]], tuple[str, ...]]:
    """Meshes with surface materials, and what the user should know; meshes of one material share it."""
    made = {id(x.material): SurfaceMaterial(x.material) for x in d.surfaces}
    tables = [surface_tables(x.mesh, x.period, quality) for x in d.surfaces]
    notes = [note for x, own in zip(d.surfaces, tables, strict=True) for note in own.notes(x.material.curvature)]
    return [(own, made[id(x.material)]) for x, own in zip(d.surfaces, tables, strict=True)], tuple(notes)


def _medium(grown: Growth, materials: dict[tuple, Material]) -> Medium:
    """materials: made so far; growths of one material share it."""
    key = id(grown.material), grown.origin
    if key not in materials:
        materials[key] = Material(grown.material, grown.origin)
    names = [p.name for p in grown.material.parameters if p.role == "alpha"]
    maps = {name: scene_dict.over_uv(image) for name, image in grown.maps.items()}
    alpha = tuple(maps.get(name, float(v)) for name, v in zip(names, grown.alpha, strict=True))
    return Medium(materials[key], alpha, grown.patches_per_uv)


def _made_surface(
    d: SurfaceDescription,
    bundle: SurfaceBundle,
    quality: Quality,
    notes: tuple[str, ...],
    twin: TwinFacts | None = None,
) -> tuple[mi.Scene, tuple[str, ...]]:
    """`_made` for a mesh with a surface material."""
    tables = surface_tables(d.mesh, d.period, quality)
    made = mi.load_dict(_parts(quality, d))
    grown = SceneShells([], [(tables, SurfaceMaterial(bundle))], convex=is_convex(d.mesh), twin=twin)
    set_shells(made, grown, quality)
    return made, (*notes, *tables.notes(bundle.curvature))


def _parts(quality: Quality, d: ShellDescription | SurfaceDescription) -> dict[str, Any]:
    """Integrator, camera, lights and objects."""
    integrator.register()
    depths = {"max_depth": quality.max_depth, "rr_depth": quality.rr_depth}
    parts: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "mesoshell_path", "hide_emitters": d.transparent, "hide_lamps": bool(d.lamps), **depths},
        "sensor": scene_dict.sensor(d.camera, 1, near_clip(d.mesh)),
    }
    parts |= {f"light{i}": scene_dict.distant(light) for i, light in enumerate(d.lights)}
    parts |= {f"lamp{i}": scene_dict.lamp(lamp) for i, lamp in enumerate(d.lamps)}
    parts |= {f"object{i}": scene_dict.surface(mesh, mesh.colour or d.base_colour) for i, mesh in enumerate(d.objects)}
    return parts if d.environment is None else parts | {"sky": scene_dict.sky(d.environment)}


def _rendered(scene: mi.Scene, samples: int, progress: Progress) -> tuple[np.ndarray, int]:
    """The picture, RGBA, as the mean of passes that fit in memory, whole grids of samples; and the number of camera rays."""
    width, height = (int(x) for x in scene.sensors()[0].film().crop_size())
    counts, left = [], samples
    while left:
        counts.append(fitting_grid(max(1, min(left, LANES // (width * height)))))
        left -= counts[-1]
    total = np.zeros((height, width, 4))
    for seed, count in enumerate(counts):
        total += count / samples * _image(scene, count, seed)
        progress(sum(counts[: seed + 1]) / samples)
    return total.astype(np.float32), width * height * samples


def _image(scene: mi.Scene, samples: int, seed: int) -> np.ndarray:
    """A picture, RGBA."""
    return as_rgba(mi.render(scene, spp=samples, seed=mi.UInt32(seed)))
