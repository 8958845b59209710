"""Render a mesh with a surface material, one query a hit, in JAX."""

from dataclasses import replace

import numpy as np

from mesoshell.io.surface import SurfaceBundle
from mesoshell.kept import kept
from mesoshell.render.effects import SURFACE, Effects, left_out, plan_effects
from mesoshell.render.facts import TwinFacts
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.render.used import quality_used
from mesoshell.scene.picture import Passes, Prepared, Progress, Rendered, tiled_passes
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import describe_surface, with_distant_lamps
from mesoshell.surface_material.loader import load_device_material
from mesoshell.surface_material.renderer import RAYS, SurfaceScene, cut_short, facts, render, tile_renderer
from mesoshell.surface_material.scene import SurfaceDescription

#: What all pictures of one scene share.
_device_material = kept(load_device_material)


def prepare_surface(scene: Scene, quality: Quality, begun: float, progress: Progress) -> Prepared:
    """The scene, ready to be rendered; progress is not called, as no texture is grown. Raises InputError."""
    d = describe_surface(scene)
    d, lamps = with_distant_lamps(d, [d.mesh])
    return prepare_surface_mesh(scene, d, scene.material.surface, quality, begun, None, (*d.mesh.notes, *lamps))


def prepare_surface_mesh(
    scene: Scene,
    d: SurfaceDescription,
    bundle: SurfaceBundle,
    quality: Quality,
    begun: float,
    twin: TwinFacts | None,
    notes: tuple[str, ...],
) -> Prepared:
    """The described mesh with a bundle's material, ready to be rendered. twin: facts, if it replaces the scene's shell."""
    surface = SurfaceScene(**vars(d), device_material=_device_material(bundle))
    effects = plan_effects(replace(facts(surface), twin=twin), quality, SURFACE)

    def work(progress: Progress) -> Rendered:
        return _rendered(quality, effects, *render(surface, quality, effects, progress))

    def passes(other: Quality | None) -> Passes:
        chosen, report = other or quality, RenderReport()
        tile = tile_renderer(surface, chosen, effects, report)

        def ended(image: np.ndarray, samples: int) -> Rendered:
            done = replace(report, notes=(*report.notes, *cut_short(report)))
            return _rendered(chosen.with_changes(pixel_samples=samples), effects, image, done)

        return tiled_passes(surface.camera, RAYS, tile, ended)

    return Prepared.now(scene, SURFACE.name, effects, (*notes, *left_out(effects)), begun, work, passes)


def _rendered(quality: Quality, effects: Effects, image: np.ndarray, report: RenderReport) -> Rendered:
    record = {
        "rays": report.counts.get("rays", 0),
        "queries": report.counts.get("queries", 0),
        "counts": report.counts,
        "effects": effects.as_dict(),
        "quality": quality_used(quality, effects, SURFACE),
    }
    return Rendered(image.astype(np.float32), report.seconds, record, report.notes)
