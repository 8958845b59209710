"""Render a neural shell by marching rays in JAX.

Notation
stretch     world length of one UV unit, averaged over the surface
"""

from dataclasses import replace
from itertools import pairwise
from math import prod

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float

from mesoshell.geometry.convex import is_convex
from mesoshell.geometry.enclosure import enclosure
from mesoshell.geometry.mesh import Mesh, bounding_box, uv_stretch
from mesoshell.kept import kept
from mesoshell.render.camera import pixel_radius, rays
from mesoshell.render.effects import MARCH, MAX_BAKED, Effects, left_out, plan_effects, plan_twin
from mesoshell.render.facts import Facts
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.render.used import quality_used
from mesoshell.scene.lod import describe_twin, twin_facts
from mesoshell.scene.picture import Passes, Prepared, Progress, Rendered, tiled_passes
from mesoshell.scene.render_surface import prepare_surface_mesh
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import ShellDescription, describe_shell, with_distant_lamps
from mesoshell.shell.geometry.extrude import is_even
from mesoshell.shell.geometry.horizon import lowest
from mesoshell.shell.geometry.join import join_shells
from mesoshell.shell.material.loader import DeviceMaterial, load_device_material
from mesoshell.shell.render.media import density_columns, density_shapes
from mesoshell.shell.render.renderer import marched_tile, render
from mesoshell.shell.render.scene import Medium
from mesoshell.shell.render.scene import Scene as MarchedScene

#: Places in the picture where distances are measured, as shares of its sides.
SEEN = (np.arange(24) + 0.5) / 24


def prepare_shell(scene: Scene, quality: Quality, begun: float, progress: Progress) -> Prepared:
    """The scene, ready to be marched; from afar, its twin replaces the shell. progress: of growing a texture. Raises
    InputError."""
    d = describe_shell(scene, progress)
    d, lamps = with_distant_lamps(d, [x.mesh for x in d.growths])
    notes = (*d.notes, *lamps)
    if any(part.growth is not None for part in (scene, *scene.also)):
        notes += ("what grows high casts no shadow on lower or bare places: engine jax cannot, engine mitsuba can",)
    twin, seen = scene.material.shell.twin, twin_facts(scene, d, quality)
    if twin is not None and plan_twin(seen, quality).on:
        return prepare_surface_mesh(scene, describe_twin(d), twin.surface, quality, begun, seen, notes)
    marched = marched_scene(d)
    known = replace(facts(marched), twin=seen)
    effects = plan_effects(known, quality)

    def work(progress: Progress) -> Rendered:
        return _rendered(quality, effects, *render(marched, quality, effects, progress))

    def passes(other: Quality | None) -> Passes:
        chosen, report = other or quality, RenderReport()
        planned = plan_effects(known, chosen)
        tile, most, compile_all = marched_tile(marched, chosen, planned, report)

        def ended(image: np.ndarray, samples: int) -> Rendered:
            return _rendered(chosen.with_changes(pixel_samples=samples), planned, image, report)

        return tiled_passes(marched.camera, most, tile, ended)._replace(compile=compile_all)

    return Prepared.now(scene, MARCH.name, effects, (*notes, *left_out(effects)), begun, work, passes)


def _rendered(quality: Quality, effects: Effects, image: np.ndarray, report: RenderReport) -> Rendered:
    counts = report.counts
    record = {
        "rays": counts.get("rays", 0),
        "queries": sum(counts.get(k, 0) for k in ("density_queries", "transport_queries", "surface_queries")),
        "counts": counts,
        "effects": effects.as_dict(),
        "quality": quality_used(quality, effects, MARCH),
    }
    return Rendered(image.astype(np.float32), report.seconds, record)


#: What all pictures of one scene share.
_device_material = kept(load_device_material)


def marched_scene(d: ShellDescription) -> MarchedScene:
    """The description as the renderer's scene."""
    mesh, shell = join_shells(tuple((x.mesh, x.shell) for x in d.growths))
    made: dict[tuple, DeviceMaterial] = {}  # of growths of one material, one
    media, prism, face = [], 0, 0
    for x in d.growths:
        key = id(x.material), x.origin
        if key not in made:
            made[key] = _device_material(x.material, x.origin)
        media.append(Medium(made[key], x.alpha, x.maps, x.patches_per_uv, prism, face))
        prism, face = prism + len(x.shell.faces), face + len(x.mesh.faces)
    return MarchedScene(
        mesh=mesh,
        shell=shell,
        device_material=media[0].device_material,
        camera=d.camera,
        lights=d.lights,
        environment=d.environment,
        alpha=d.alpha,
        maps=d.maps,
        patches_per_uv=d.patches_per_uv,
        others=tuple(media[1:]),
        base_colour=d.base_colour,
        objects=d.objects,
        transparent=d.transparent,
        holdout=d.holdout,
    )


def facts(scene: MarchedScene) -> Facts:
    """The facts that the effects are planned from."""
    corners = bounding_box(scene.mesh)
    far = np.linalg.norm(np.abs(corners - scene.camera.to_world[:3, 3]).max(axis=0))
    media, layouts = scene.media, [m.device_material.layout for m in scene.media]
    patches = [_patch(scene, *ends) for ends in pairwise([*(m.prism for m in media), len(scene.shell.faces)])]
    footprint = pixel_radius(scene.camera.spread) / 2 * far
    convex = not scene.others and is_even(scene.mesh, scene.shell) and is_convex(scene.mesh)
    ends = np.concatenate([scene.shell.base, scene.shell.base + scene.shell.offset])
    eye = scene.camera.to_world[:3, 3]
    grids = density_shapes(scene)
    meshes = _meshes(scene.mesh, tuple(m.face for m in scene.others))
    return Facts(
        shells=len(media),
        objects=len(scene.objects),
        distant=len(scene.lights),
        environment=scene.environment is not None,
        seen=not scene.transparent,
        convex=convex,
        enclosed=0.0 if convex and not scene.objects else enclosure((*meshes, *scene.objects)),
        low=scene.environment is not None
        or lowest(scene.shell, np.array([x.direction for x in scene.lights]).reshape(-1, 3)) <= 0,
        ground=max([*scene.base_colour, *(x for mesh in scene.objects for x in mesh.colour or ())]),
        coarsest=max(
            float(2 * footprint / p * layout.texel_density) for p, layout in zip(patches, layouts, strict=True)
        ),
        baked=sum(prod(shape) for shape in grids),
        pixels=scene.camera.width * scene.camera.height,
        magnified=_magnified(scene, patches, MAX_BAKED // len(grids)),
        rows=max(layout.height_sizes[0][0] for layout in layouts),
        inside=bool(((ends.min(axis=0) <= eye) & (eye <= ends.max(axis=0))).all()),
        varying=tuple(dict.fromkeys(name for m in media for name in m.maps)),
        shaped=any(layout.nodes is not None for layout in layouts),
        tiled=any(layout.colours is not None for layout in layouts),
    )


def _magnified(scene: MarchedScene, patches: list[float], most: int) -> float:
    """How wide columns of the grids are seen from near, over a pixel's footprint. patches: world length of each medium's."""
    near, radius = _near(scene), pixel_radius(scene.camera.spread)
    columns = [density_columns(medium, most) for medium in scene.media]
    return max(patch / n / (radius * near) for patch, n in zip(patches, columns, strict=True))


def _near(scene: MarchedScene) -> float:
    """The distance that a tenth of the camera's rays that meet a surface do not reach; infinite if none meets one."""
    camera = scene.camera
    places = np.stack(np.meshgrid(SEEN * camera.width, SEEN * camera.height), axis=-1).reshape(-1, 2)
    o, d = rays(camera, places)
    surfaces, centre = _surfaces((scene.mesh, *scene.objects))
    hits = surfaces.run((o - centre).astype(np.float32), d.astype(np.float32), output=True)
    far = hits["tfar"][hits["geomID"] >= 0]
    return float(np.quantile(far, 0.1)) if len(far) else np.inf


@kept
def _surfaces(meshes: tuple[Mesh, ...]) -> tuple[EmbreeScene, Float[np.ndarray, "3"]]:
    """Meshes as rays meet them, about their centre."""
    corners = np.concatenate([mesh.vertices.astype(np.float64)[mesh.faces] for mesh in meshes])
    centre, scene = corners.mean(axis=(0, 1)), EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(corners - centre, np.float32))
    return scene, centre


@kept
def _meshes(mesh: Mesh, first: tuple[int, ...]) -> tuple[Mesh, ...]:
    """The meshes that were joined. first: face of each but the first."""
    if not first:
        return (replace(mesh),)
    parts = zip(np.split(mesh.faces, first), np.split(mesh.uv, first), strict=True)
    return tuple(replace(mesh, faces=faces, uv=uv) for faces, uv in parts)


def _patch(scene: MarchedScene, first: int, end: int) -> float:
    """World length of a patch, averaged over the faces under some prisms."""
    shell = scene.shell
    own = Mesh(shell.base, shell.faces[first:end], shell.uv[first:end], np.zeros_like(shell.base), ())
    return uv_stretch(own)
