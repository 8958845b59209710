"""Level of detail: replace a shell by the surface material distilled from it, its twin, where the scene allows it (no JAX).
`render/effects.plan_twin` decides."""

import numpy as np

from mesoshell.geometry.mesh import Mesh, bounding_box, uv_stretch
from mesoshell.geometry.normals import vertex_normals
from mesoshell.io.twin import Twin
from mesoshell.kept import constant, is_constant, kept
from mesoshell.render.camera import pixel_radius
from mesoshell.render.effects import twin_reach
from mesoshell.render.facts import TwinFacts
from mesoshell.render.quality import Quality
from mesoshell.scene.growth import grows
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import ShellDescription
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.surface_material.scene import SurfaceDescription
from mesoshell.surface_material.tables import surface_tables

#: How much a scene may differ from what was distilled: in thickness over patch, and in a colour or a parameter.
THICKNESS, VALUE = 0.1, 1e-3


def twin_facts(scene: Scene, d: ShellDescription, quality: Quality) -> TwinFacts | None:
    """The facts that decide whether the twin may replace the shell; None if the material has no twin."""
    twin = scene.material.shell.twin
    if twin is None:
        return None
    top = surface(d.shell)
    low, high = bounding_box(top)
    eye = d.camera.to_world[:3, 3]
    near = float(np.linalg.norm(np.maximum(np.maximum(low - eye, eye - high), 0)))
    finest = float(pixel_radius(d.camera.spread) / 2 * near / uv_stretch(top))
    misfit = _misfit(scene, d, twin)
    if not misfit and finest >= twin_reach(twin.errors, quality.twin):
        misfit = _bent(top, twin, quality)
    return TwinFacts(finest, twin.errors, misfit)


def describe_twin(d: ShellDescription) -> SurfaceDescription:
    """The scene with the shell's top as its mesh, for a surface material."""
    top = surface(d.shell)
    return SurfaceDescription(
        mesh=top,
        period=uv_stretch(top),
        camera=d.camera,
        lights=d.lights,
        environment=d.environment,
        base_colour=d.base_colour,
        objects=d.objects,
        transparent=d.transparent,
        lamps=d.lamps,
    )


@kept
def surface(shell: Shell) -> Mesh:
    """The top of a shell; its texture coordinates are patches."""
    top = (shell.base + shell.offset).astype(np.float32)
    mesh = Mesh(top, shell.faces, shell.uv, vertex_normals(top, shell.faces)[0].astype(np.float32), ())
    return constant(mesh) if is_constant(shell) else mesh


def _misfit(scene: Scene, d: ShellDescription, twin: Twin) -> str:
    if grows(scene):
        return "a texture is grown"
    if scene.holdout:
        return "objects are held out"
    if d.others or d.surfaces:
        return "another material grows beside it"
    if d.maps:
        return f"{next(iter(d.maps))} varies"
    if not np.allclose(d.alpha, twin.alpha, rtol=0, atol=VALUE):
        return "it has other parameters"
    if not np.allclose(d.base_colour, twin.base, rtol=0, atol=VALUE):
        return "the surface under it has another colour"
    if len(d.shell.faces) < len(d.mesh.faces):
        return "parts of the mesh carry none"
    patch = uv_stretch(d.mesh) / d.patches_per_uv
    thickness = np.linalg.norm(d.shell.offset, axis=1) / patch
    if np.abs(thickness / twin.surface.depth - 1).max() > THICKNESS:
        return (
            f"it is {thickness.min():.2g} to {thickness.max():.2g} of a patch thick, and not {twin.surface.depth:.2g}"
        )
    return ""


def _bent(top: Mesh, twin: Twin, quality: Quality) -> str:
    kappa = surface_tables(top, uv_stretch(top), quality).table.kappa * uv_stretch(top)
    low, high = twin.surface.curvature
    if kappa.min() >= low and kappa.max() <= high:
        return ""
    return f"curvature is {kappa.min():.2g} to {kappa.max():.2g} a patch, and not {low:g} to {high:g}"
