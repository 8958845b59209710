"""Facts of a Mitsuba scene for `render/effects`: its emitters, surfaces, cameras, shells and surface materials."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.pathtracer.media import Medium, baked_size, grid_columns
from mesoshell.pathtracer.surface_material import SurfaceMaterial
from mesoshell.pathtracer.texture_lod import PINHOLES, coarsest, eye_of, magnified
from mesoshell.render.facts import Facts
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.horizon import lowest
from mesoshell.surface_material.tables import SurfaceTables

#: BSDF flags of a plain diffuse surface.
_DIFFUSE = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide


def facts_of(
    scene: mi.Scene,
    shells: list[tuple[Shell, Medium]],
    surfaces: list[tuple[SurfaceTables, SurfaceMaterial]],
    convex: bool,
) -> Facts:
    """shells: with their media; surfaces: meshes with their surface materials. convex: all these meshes are."""
    integrator: Any = scene.integrator()
    kinds = [_kind(e) for e in scene.emitters()]
    geometry, media = [shell for shell, _ in shells], [medium for _, medium in shells]
    solid = [s for s in scene.shapes() if not (integrator.hide_lamps and s.is_emitter())]
    others = len(solid)  # meshes with surface materials are not among them
    heights, densities = [m.material.heights for m in media], [m.material.density for m in media]
    grouped = any(s.class_name() == "Instance" for s in scene.shapes())  # an instance may hold other meshes too
    return Facts(
        shells=len(shells),
        surfaces=len(surfaces),
        objects=others - (len(shells) == 1 and not surfaces and not grouped),
        distant=kinds.count("distant"),
        point=kinds.count("point"),
        area=kinds.count("area"),
        environment="environment" in kinds,
        seen=not integrator.hide_emitters,
        convex=convex,
        enclosed=0.0 if convex and others + len(surfaces) == 1 else 1.0,
        low=len(kinds) > kinds.count("distant") or any(lowest(s, _toward(scene)) <= 0 for s in geometry),
        ground=max((_albedo(s.bsdf()) for s in solid), default=0.0),
        coarsest=coarsest(scene.sensors(), geometry, densities),
        magnified=magnified(scene, geometry, grid_columns(media)),
        baked=baked_size(media),
        rows=max((h.rows for h in heights), default=0),
        inside=bool(geometry) and any(_may_be_inside(s, geometry) for s in scene.sensors()),
        varying=tuple(sorted({name for m in media for name in m.varying})),
        shaped=any(h.nodes is not None for h in heights),
        tiled=any(m.material.tiles is not None for m in media),
        passable=any(m.opacity != "none" for _, m in surfaces),
    )


def _albedo(bsdf: mi.BSDF | None) -> float:
    """Largest albedo of a diffuse surface of one colour, as written (0.1, not float32's); 1 for other surfaces."""
    if bsdf is None or int(bsdf.flags()) & ~int(_DIFFUSE):
        return 1.0
    varying = [k for k, _ in mi.traverse(bsdf) if not k.endswith("reflectance.value")]
    if varying:
        return 1.0
    at: Any = dr.zeros(mi.SurfaceInteraction3f)
    at.wi = mi.Vector3f(0, 0, 1)
    return round(float(np.max(np.array(bsdf.eval_diffuse_reflectance(at)))), 6)


def _toward(scene: mi.Scene) -> np.ndarray:
    """Directions toward the distant lights, (L, 3)."""
    directions = [np.array(distant(e)[0]).ravel() for e in scene.emitters() if _kind(e) == "distant"]
    return np.array(directions).reshape(-1, 3)


def distant(emitter: mi.Emitter) -> tuple[mi.Vector3f, mi.Color3f]:
    """Direction toward a distant light, and E⊥."""
    light: Any = emitter
    ds, value = light.sample_direction(dr.zeros(mi.Interaction3f), mi.Point2f(0.5))
    return mi.Vector3f(ds.d), mi.Color3f(value)


def _may_be_inside(sensor: mi.Sensor, shells: list[Shell]) -> bool:
    """Whether rays may begin in a shell: a pinhole's or a lens's do not if it lies outside the shells' bounds."""
    ends = np.concatenate([x for s in shells for x in (s.base, s.base + s.offset)])
    eye = eye_of(sensor)
    inside = ((ends.min(axis=0) <= eye) & (eye <= ends.max(axis=0))).all()
    return sensor.class_name() not in PINHOLES or bool(inside)


def _kind(emitter: mi.Emitter) -> str:
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.Infinite):
        return "distant" if mi.has_flag(flags, mi.EmitterFlags.DeltaDirection) else "environment"
    return "point" if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition) else "area"
