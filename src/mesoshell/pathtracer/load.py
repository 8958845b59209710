"""From a scene with shells to an ordinary `mi.Scene`, whose integrator traces paths through them.

scene = load_file("scene.xml")
image = mi.render(scene, spp=64)
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, cast

import mitsuba as mi
import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.convex import is_convex
from mesoshell.geometry.mesh import Mesh, check_mesh, surface_area, transform_mesh
from mesoshell.io.atomic import read_file
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import bundled_materials, check_name, find, parameter_vector
from mesoshell.io.surface import KIND, kind_of, read_surface
from mesoshell.pathtracer import integrator, xml_bsdf
from mesoshell.pathtracer.facts import facts_of
from mesoshell.pathtracer.maps import check_map, field_of
from mesoshell.pathtracer.material import Material
from mesoshell.pathtracer.media import Media, Medium
from mesoshell.pathtracer.render_context import RenderContext
from mesoshell.pathtracer.shells import Shells
from mesoshell.pathtracer.surface_material import SurfaceMaterial, SurfaceMeshes
from mesoshell.pathtracer.texture_cache import TextureKey, with_texture
from mesoshell.pathtracer.texture_lod import texels_needed
from mesoshell.pathtracer.xml_bsdf import Element
from mesoshell.render.effects import PATHS, plan_effects
from mesoshell.render.facts import Facts, TwinFacts
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.shell.geometry.extrude import Shell, extrude, patches_per_uv, proportions, transform_shell
from mesoshell.surface_material.scene import default_period
from mesoshell.surface_material.tables import SurfaceTables, surface_tables

NORMAL = PRESETS["normal"]
#: Texels that a footprint may reach of a sensor that is moved.
EVERYWHERE = 1e6
#: The variant in which all modules here were made.
LOADED = str(mi.variant())


def load_file(path: str | PathLike[str], quality: Quality = NORMAL, **parameters: Any) -> mi.Scene:
    """Load a scene from Mitsuba's XML, with any shells in it; parameters: for its `$name`s. Files beside it are found first.

    Raises InputError in one line."""
    return load_sized(path, quality, None, parameters)


def load_sized(
    path: str | PathLike[str],
    quality: Quality,
    size: tuple[int, int] | None,
    parameters: Mapping[str, Any],
    anywhere: bool = False,
) -> mi.Scene:
    """`load_file`. size: width and height of the film; None: its own. anywhere: whether its sensor will be moved."""
    if not Path(path).is_file():
        raise InputError(path, "no such file")
    try:
        read_file(path).decode()
    except UnicodeDecodeError as error:  # Mitsuba's parser accepts it, and fails later where it names a node
        raise InputError(path, "is not UTF-8 text") from error
    given = {key: str(value) for key, value in parameters.items()}
    resolver = cast(Any, mi).file_resolver()
    before = [str(p) for p in resolver]
    resolver.prepend(mi.filesystem.path(str(Path(path).resolve().parent)))
    try:
        read = lambda config: mi.parser.parse_file(config, str(path), **given)  # noqa: E731
        return _loaded(str(path), read, quality, size, anywhere)
    finally:
        resolver.clear()
        for folder in before:
            resolver.append(mi.filesystem.path(folder))


def load_dict(scene: dict[str, Any], quality: Quality = NORMAL) -> mi.Scene:
    """Load a scene from a dict, as `mi.load_dict` does."""
    return _loaded("scene", lambda config: mi.parser.parse_dict(config, scene), quality)


def _loaded(
    source: str, parse: Callable, quality: Quality, size: tuple[int, int] | None = None, anywhere: bool = False
) -> mi.Scene:
    integrator.register()
    if str(mi.variant()) != LOADED:
        raise InputError("mitsuba", f"variant {mi.variant()} is set; mesoshell was loaded in {LOADED}: set that again")
    scene, elements = xml_bsdf.read(source, parse, lambda material: kind_of(_file(material)) == KIND, size)
    elements = [e for e in elements if e.placed != ()]  # else of a shape group that nothing shows
    if elements or isinstance(scene.integrator(), integrator.ShellPath):
        materials: dict[Any, Any] = {}
        shells, surfaces, convex, notes = [], [], True, []
        for element in elements:
            try:
                mesh = _mesh(element)
                if element.is_surface_material:
                    added, own_notes = _surfaces(element, mesh, quality, materials)
                    surfaces += added
                else:
                    added = _shells(element, mesh, [] if anywhere else scene.sensors(), quality, materials)
                    shells, own_notes = shells + added, added[0][0].notes
            except InputError as error:
                raise InputError(element.where, str(error).replace("`", "")) from error
            convex &= is_convex(mesh)
            notes += [f"{element.where}: {note}" for note in (*mesh.notes, *own_notes)]
        set_shells(scene, SceneShells(shells, surfaces, convex, tuple(notes)), quality)
        context = getattr(scene.integrator(), "context", None)
        if anywhere and context is not None:  # what a plan may leave out for some sensors
            context.facts = replace(context.facts, coarsest=EVERYWHERE, inside=True)
            set_quality(scene, quality)
    return scene


@dataclass(frozen=True, eq=False)
class SceneShells:
    """Shells of a scene with their media, and meshes with their surface materials. convex: all these meshes are. notes: how
    they depart from the request. twin: of the material (render/effects)."""

    shells: list[tuple[Shell, Medium]]
    surfaces: list[tuple[SurfaceTables, SurfaceMaterial]] = field(default_factory=list)
    convex: bool = False
    notes: tuple[str, ...] = ()
    twin: TwinFacts | None = None


def set_shells(scene: mi.Scene, grown: SceneShells, quality: Quality) -> None:
    """Give a scene's integrator, a `mesoshell_path`, its shells and surface materials. Path depths are the integrator's.

    Raises InputError for a quality that paths cannot have."""
    shells = media = surface_meshes = None
    if grown.shells:
        shells = Shells([shell for shell, _ in grown.shells])
        media = Media(shells, [medium for _, medium in grown.shells])
    if grown.surfaces:
        surface_meshes = SurfaceMeshes(
            [tables for tables, _ in grown.surfaces], [material for _, material in grown.surfaces]
        )
    path: Any = scene.integrator()
    quality = quality.with_changes(max_depth=max(path.max_depth, 1), rr_depth=max(path.rr_depth, 1))
    facts = replace(facts_of(scene, grown.shells, grown.surfaces, grown.convex), twin=grown.twin)
    path.context = _context(scene, quality, facts, shells, media, surface_meshes, grown.notes)


def set_quality(scene: mi.Scene, quality: Quality) -> None:
    """Render a scene with shells with another quality from now on, its path depths too; a scene without stays as it is."""
    path: Any = scene.integrator()
    context = getattr(path, "context", None)
    if context is not None:
        path.max_depth, path.rr_depth = quality.max_depth, quality.rr_depth
        path.context = _context(
            scene, quality, context.facts, context.shells, context.media, context.surface_meshes, context.notes
        )


def _context(
    scene: mi.Scene,
    quality: Quality,
    facts: Facts,
    shells: Shells | None,
    media: Media | None,
    surface_meshes: SurfaceMeshes | None,
    notes: tuple[str, ...],
) -> RenderContext:
    """What a scene's integrator holds, with the effects that the facts call for. Raises InputError (`set_shells`)."""
    if shells is not None and quality.spacing == "interval":
        raise InputError(
            Argument("spacing"),
            f"'{quality.spacing}' requires `engine` jax: paths have samples by density or length",
        )
    effects = plan_effects(facts, quality, PATHS)
    return RenderContext(shells, media, surface_meshes, quality, effects, _extent(scene, shells), notes, facts)


def _extent(scene: mi.Scene, shells: Shells | None) -> float:
    """Greatest side of the box around all that stands in a scene."""
    box = scene.bbox()
    ends = [np.array([box.min, box.max], np.float64)] if box.valid() else []
    ends += [] if shells is None else [shells.box]
    low, high = (f([end[k] for end in ends], axis=0) for k, f in ((0, np.min), (1, np.max))) if ends else (0.0, 1.0)
    return float(np.max(high - low))


def _shells(
    element: Element, mesh: Mesh, sensors: list[mi.Sensor], quality: Quality, materials: dict
) -> list[tuple[Shell, Medium]]:
    """The shells of an element, one for each placement, with their medium."""
    path = _file(element.material)
    bundle = read_bundle(path)
    shell = extrude(mesh, *proportions(mesh, bundle.thickness, element.thickness, element.scale))
    for name, texture in element.textures.items():
        check_name(bundle, name, element.material)
        check_map(name, texture, element.material)
    alpha = parameter_vector(bundle, element.numbers, "alpha", element.material)
    places = [shell] if element.placed is None else [transform_shell(shell, m) for m in element.placed]
    most = int(bundle.texel_density)
    footprint = quality.footprint if quality.filtering or quality.density == "baked" else 0.0
    texels = most if bundle.generator is None else texels_needed(sensors, places, most, footprint)
    names, patches = [p.name for p in bundle.parameters if p.role == "alpha"], patches_per_uv(mesh, shell)
    fields = {
        name: field_of(name, texture, patches, element.flipped, mesh.uv, element.material)
        for name, texture in element.textures.items()
        if name not in names
    }
    baked, origin, key = with_texture(path, bundle, shell.uv, TextureKey(element.seed, element.numbers, texels, fields))
    if key not in materials:
        materials[key] = Material(baked, origin)
    values = tuple(element.textures.get(name, float(v)) for name, v in zip(names, alpha, strict=True))
    medium = Medium(materials[key], values, patches, element.flipped)
    return [(s, medium) for s in places]


def _surfaces(
    element: Element, mesh: Mesh, quality: Quality, materials: dict
) -> tuple[list[tuple[SurfaceTables, SurfaceMaterial]], tuple[str, ...]]:
    """The surfaces of an element, one for each placement, with their material; and notes on them."""
    given = [
        *element.numbers,
        *element.textures,
        *(k for k in ("thickness", "seed") if getattr(element, k) is not None),
    ]
    if given:
        raise InputError(element.material, f"{given[0]} is for shells: a surface material takes only a scale")
    path = _file(element.material)
    bundle = read_surface(path)
    period = default_period(mesh) if element.scale is None else element.scale
    if not (np.isfinite(period) and period > 0):
        raise InputError(element.material, f"scale must be above 0, not {period:g}")
    material = materials.setdefault(path, SurfaceMaterial(bundle))
    places = [mesh] if element.placed is None else [transform_mesh(mesh, m, element.material) for m in element.placed]
    # periods of an instance scale with its edges
    tables = [surface_tables(m, period * (surface_area(m) / surface_area(mesh)) ** 0.5, quality) for m in places]
    return [(w, material) for w in tables], tables[0].notes(bundle.curvature)


def _file(material: str) -> Path:
    """A bundled material's file, or one in Mitsuba's search path."""
    resolver = cast(Any, mi).file_resolver()
    return find(material if material in bundled_materials() else str(resolver.resolve(material)))


def _mesh(element: Element) -> Mesh:
    """The mesh of a shape, welded, in world space."""
    shape = element.shape
    faces = np.array(shape.faces_buffer()).reshape(-1, 3).astype(np.int64)
    points = np.array(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    uv = None
    if shape.has_vertex_texcoords():
        uv = np.array(shape.vertex_texcoords_buffer(), np.float64).reshape(-1, 2)[faces]
        if element.flipped:
            uv[..., 1] = 1 - uv[..., 1]
    elif element.textures:
        raise InputError(element.material, f"texture for '{next(iter(element.textures))}': the mesh has no UVs")
    return check_mesh(points, faces, uv, element.material)
