"""Which effects of path tracing a scene calls for: decided from its objects, before anything is compiled.

What is off is not in the compiled program, or, of rays that a loop takes anyway, not done; `mesoshell render --explain` prints
the reasons.
"""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mesoshell.pathtracer.detail import PINHOLES, eye_of
from mesoshell.render.effects import Effect


@dataclass(frozen=True)
class PathEffects:
    """One field an effect. quadrature: all samples of a ray are summed, in place of one that is drawn."""

    camera_in_shell: Effect
    asking_emitters: Effect
    hitting_emitters: Effect
    second_bounce: Effect
    roulette: Effect
    shell_on_shell: Effect
    quadrature: Effect
    varying_parameters: Effect
    shells: Effect
    surface_materials: Effect

    def as_dict(self) -> dict[str, dict[str, object]]:
        return {name: {"on": e.on, "why": e.why} for name, e in vars(self).items()}


@dataclass(frozen=True, eq=False)
class Facts:
    """What the decisions rest on, beside the scene. box: least and greatest corner of all shells, None without any; alone:
    there is one shell, on a convex surface, and nothing else of ours; varying: parameters that textures give; worn: how many
    meshes wear surface materials."""

    box: np.ndarray | None
    alone: bool
    varying: list[str]
    worn: int


def plan_paths(scene: mi.Scene, facts: Facts) -> PathEffects:
    """Decide each effect."""
    box, alone, varying = facts.box, facts.alone, facts.varying
    integrator: Any = scene.integrator()
    emitters = scene.emitters()
    kinds = [_kind(e) for e in emitters]
    hit = sorted({k for k in kinds if k not in ("distant", "point")})
    found = ", ".join(f"{kinds.count(k)} {k}" for k in sorted(set(kinds))) or "none"
    inside = box is not None and any(_may_be_inside(s, box) for s in scene.sensors())
    once, short = integrator.max_depth <= 2, integrator.max_depth <= integrator.rr_depth
    summed = once and alone and set(kinds) == {"distant"}
    onward = not once or (integrator.max_depth > 1 and bool(hit))

    def effect(on: bool, why: str, why_not: str) -> Effect:
        return Effect(on, why if on else why_not)

    return PathEffects(
        camera_in_shell=effect(inside, "a camera may be within the shells' bounds", "cameras are outside all shells"),
        asking_emitters=effect(bool(kinds) and integrator.max_depth > 1, f"emitters: {found}", f"emitters: {found}"),
        hitting_emitters=effect(bool(hit), f"paths may end on: {', '.join(hit)}", "no path can meet an emitter"),
        second_bounce=effect(
            onward,
            "paths go on after an event" if not once else "a direction is drawn at an event: it may meet an emitter",
            f"max_depth is {integrator.max_depth}: no direction is drawn at an event",
        ),
        roulette=effect(not short, f"paths end by chance from length {integrator.rr_depth} on", "paths are short"),
        shell_on_shell=effect(
            not alone and box is not None,
            "light may cross shells again",
            "no shells" if box is None else "one shell, on a convex surface: what leaves it stays outside",
        ),
        quadrature=effect(
            summed,
            "distant lights, one event: all samples of a ray are summed, with little noise",
            "paths go on, or light is not distant: collisions are drawn",
        ),
        varying_parameters=effect(bool(varying), f"textures for {', '.join(varying)}", "every parameter is one number"),
        shells=effect(box is not None, "rays are marched through shells", "no shells"),
        surface_materials=effect(facts.worn > 0, f"{facts.worn} of meshes: rays may pass them", "no mesh wears one"),
    )


def _may_be_inside(sensor: mi.Sensor, box: np.ndarray) -> bool:
    """Whether rays may begin in a shell: those of a pinhole or a lens do not if it is outside the shells' bounds."""
    eye = eye_of(sensor)
    return sensor.class_name() not in PINHOLES or bool(((box[0] <= eye) & (eye <= box[1])).all())


def _kind(emitter: mi.Emitter) -> str:
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.Infinite):
        return "distant" if mi.has_flag(flags, mi.EmitterFlags.DeltaDirection) else "environment"
    return "point" if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition) else "area"
