"""Paths through a scene with shells: next-event estimation, and MIS over all emitters.

Notation
β           throughput of the path so far                                        RGB
segment     of a path, from one event to the next; or of a shadow, from an event to an emitter
event       a collision in a shell, a surface, or a surface material             (pathtracer/events)
α           opacity of a surface material: a path goes through it with the probability 1 − α, and a shadow is dimmed by 1 − α

A lane follows its path segment by segment; what it asks of an emitter is a segment too, taken before the path goes on. So all
flights through shells, of paths and of shadows, are one piece of the compiled program. What a scene does not call for
(render/effects) is not in it.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.events import at_collision, at_surface, at_surface_material, beyond, power, single
from mesoshell.pathtracer.free_flight import fly, still
from mesoshell.pathtracer.samples import Ray
from mesoshell.pathtracer.surface_material import nothing_met

#: How far past a lamp a ray goes on, relative to the distance and the coordinates of where it meets it.
PAST = 2e-6


@dataclass
class Path:
    """A path under way: the segment to come, β, relative index of refraction squared away, and its last event."""

    ray: Ray
    beta: mi.Color3f
    eta: mi.Float
    depth: mi.UInt32
    alive: mi.Bool
    p: mi.Point3f
    pdf: mi.Float
    delta: mi.Bool


@dataclass
class Shadow:
    """What a path waits for: the segment to an emitter, the radiance if all of it comes through, and whether shells may lie
    between."""

    ray: Ray
    radiance: mi.Color3f
    crosses: mi.Bool
    pending: mi.Bool


@dataclass
class PathState:
    """A path, its shadow, the light that it has brought so far, whether it met anything, and samples decoded."""

    path: Path
    shadow: Shadow
    light: mi.Color3f
    valid: mi.Bool
    queries: mi.UInt32


@dataclass(frozen=True)
class Plan:
    """What a scene calls for (render/effects), known before anything is compiled. emitters: a path may meet one; hidden: rays
    from the camera pass those that have an extent; ghosts: so does all else, and takes their light along; onward: a path goes
    on after its first event."""

    max_depth: int
    emitters: bool
    hidden: bool
    ghosts: bool
    onward: bool
    direct: bool
    shell_shadow: bool
    roulette: bool
    shells: bool
    surface_materials: bool


@dataclass
class SegmentEnd:
    """Where a segment ends. mine: it is the path's, not a shadow's; si, met, flight: what it meets of surfaces, surface
    materials and shells; blocked: a surface stops the shadow; lamp: it ends at one that it passes; past: from where it then
    goes on."""

    mine: mi.Bool
    si: mi.SurfaceInteraction3f
    blocked: mi.Bool
    lamp: mi.Bool
    past: mi.Float
    met: Any
    flight: Any


def begin(settings, scene, ray: Ray, active) -> PathState:
    """A path from the camera. settings: a ShellPath."""
    n = dr.width(ray.o)
    no, one = dr.full(mi.Bool, False, n), dr.full(mi.Float, 1, n)
    path = Path(
        ray,
        dr.full(mi.Color3f, 1, n),
        one,
        dr.zeros(mi.UInt32, n),
        mi.Bool(active) & ~no,
        mi.Point3f(ray.o),
        mi.Float(one),
        ~no,
    )
    shadow = Shadow(ray, dr.zeros(mi.Color3f, n), mi.Bool(no), mi.Bool(no))
    sky = scene.environment() is not None and not settings.hide_emitters
    return PathState(path, shadow, dr.zeros(mi.Color3f, n), dr.full(mi.Bool, sky, n), dr.zeros(mi.UInt32, n))


def busy(lane: PathState):
    """Whether a lane has a path or a shadow ray under way."""
    return lane.path.alive | lane.shadow.pending


def advance(settings, scene, sampler, lane):
    """One segment: of the shadow that a lane waits for, or of its path."""
    plan = _plan(settings)
    end = _trace(settings.context, plan, scene, sampler, lane)
    shadow, light, passing = _arrive(settings.context, plan, lane, end)

    uncollided = end.mine & ~end.flight.collided
    reached, on_material = uncollided & ~end.met.hit, uncollided & end.met.hit
    kept, lamp = mi.Bool(False), reached & end.lamp
    if plan.surface_materials:
        kept = on_material & end.met.front & (sampler.next_1d() < end.met.alpha)
    if plan.emitters:
        seen = reached & ~(lamp & (lane.path.depth == 0)) if plan.hidden else reached
        light += _emitted(settings, scene, end.si, lane.path, seen)
    reached &= ~lamp
    stopped = (end.mine & end.flight.collided) | kept | (reached & end.si.is_valid())
    going = stopped & (lane.path.depth + 1 < plan.max_depth)

    event, p, shadow = _scatter(
        settings.context, plan, scene, sampler, lane.path, end, (going, kept, reached), shadow, passing
    )
    behind, t = on_material & ~kept, mi.Float(0)
    if plan.surface_materials:
        t = settings.context.surface_meshes.beyond(end.met.t)
    if plan.hidden:
        behind |= lamp
        t = dr.select(lamp, end.past, t)
    path = _go_on(settings, plan, sampler, lane.path, end, event, p, going, (behind, t))
    return PathState(path, shadow, light, lane.valid | stopped, lane.queries + end.flight.queries)


def _plan(settings) -> Plan:
    effects, most = settings.context.effects, settings.max_depth
    if not effects.bounces.on:
        most = min(most, 2)
    emitters = effects.environment.on or effects.area_light.on
    return Plan(
        most,
        emitters,
        (settings.hide_emitters or settings.hide_lamps) and effects.area_light.on,
        settings.hide_lamps and effects.area_light.on,
        most > 1 and (effects.bounces.on or emitters),
        effects.direct_light.on,
        effects.shell_shadow.on,
        effects.roulette.on,
        effects.shells.on,
        effects.surface_materials.on,
    )


def _trace(context, plan: Plan, scene, sampler, lane: PathState) -> SegmentEnd:
    """Find the end of a lane's segment: surfaces, then surface materials in front of them, then shells in front of both."""
    path, shadow = lane.path, lane.shadow
    mine = ~shadow.pending
    n, segment = dr.width(path.eta), dr.select(shadow.pending, shadow.ray, path.ray)
    whole = mine | shadow.pending if plan.ghosts else mine
    si = scene.ray_intersect(single(segment), mi.RayFlags.All, coherent=mi.Bool(False), active=whole)
    blocked = lamp = mi.Bool(False)
    if plan.hidden:
        lamp = si.is_valid() & si.shape.is_emitter() & (mi.Bool(plan.ghosts) | (path.depth == 0))
    if context.surfaces_shadow and plan.ghosts:
        blocked = shadow.pending & si.is_valid() & ~lamp
    elif context.surfaces_shadow:
        blocked = scene.ray_test(single(shadow.ray), active=shadow.pending)
    segment.tmax = dr.select((mine & si.is_valid()) | lamp, mi.Float64(si.t), segment.tmax)
    met = nothing_met(n)
    if plan.surface_materials:
        met = context.surface_meshes.meet(segment, mine | ~blocked)
        segment.tmax = dr.select(met.hit, mi.Float64(met.t), segment.tmax)
    flight = still(n)
    if plan.shells:
        target = dr.select(mine, -dr.log(1 - sampler.next_1d()), context.dark)
        flight = fly(context, segment, target, mine | (shadow.crosses & ~blocked), sampler.next_1d())
    past = si.t + PAST * (si.t + dr.max(dr.abs(si.p))) if plan.hidden else mi.Float(0)
    return SegmentEnd(mine, si, blocked, lamp, past, met, flight)


def _arrive(context, plan: Plan, lane: PathState, end: SegmentEnd):
    """End a shadow, or take it on behind a surface material or a lamp. Returns it, the lane's light, and whether it goes on."""
    shadow = lane.shadow
    arrived = shadow.pending & ~end.blocked
    passing = arrived & (end.met.hit | end.lamp)
    radiance = shadow.radiance * dr.select(arrived, dr.exp(-mi.Float(end.flight.depth)), 0)
    light = lane.light + dr.select(arrived & ~passing, radiance, 0)
    ray = shadow.ray
    if plan.surface_materials:
        radiance *= dr.select(end.met.front, 1 - end.met.alpha, 1)
        ray = beyond(ray, context.surface_meshes.beyond(end.met.t))
        passing &= ~end.met.hit | (dr.max(radiance) > 0)
    if plan.ghosts:
        at_lamp = passing & ~end.met.hit
        radiance = dr.select(at_lamp, shadow.radiance * dr.exp(-mi.Float(end.flight.depth)), radiance)
        ray = dr.select(at_lamp, beyond(shadow.ray, end.past), ray)
    return Shadow(ray, radiance, shadow.crosses, shadow.pending), light, passing


@dr.syntax
def _scatter(context, plan, scene, sampler, path, end, where, shadow, passing):
    """Sample an emitter, and scatter the path. where: lanes that go on, those at surface materials, and those at surfaces.
    Returns the event, its place, and the shadow that the lane waits for now."""
    shells, surface_materials, direct, onward = plan.shells, plan.surface_materials, plan.direct, plan.onward
    shell_shadow = mi.Bool(plan.shell_shadow)
    going, kept, reached = where
    si, met, flight, opening = end.si, end.met, end.flight, context.quality.bounce_spread
    inside, at_material, surface = going & end.mine & flight.collided, going & kept, going & reached
    t = dr.select(inside, flight.sample.t, met.t)
    origin = mi.SurfaceInteraction3f(si)
    origin.p = dr.select(surface, si.p, mi.Point3f(path.ray.o + mi.Float64(t) * path.ray.d))
    n = dr.width(path.eta)
    ds, arriving = dr.zeros(mi.DirectionSample3f, n), dr.zeros(mi.Color3f, n)
    if direct:
        smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        lit = inside | at_material | (surface & smooth)
        ds, arriving = scene.sample_emitter_direction(origin, sampler.next_2d(), False, lit)
    wanted = going & (ds.pdf != 0)
    numbers = (sampler.next_1d(), sampler.next_2d()) if onward else None
    event = at_surface(context, si, path.ray, ds, surface & wanted, surface, numbers, opening)
    if shells and inside:
        event = at_collision(context, flight, path.ray, ds, numbers and numbers[1], opening)
    if surface_materials and at_material:
        event = at_surface_material(context, met, path.ray, ds, numbers and numbers[1], opening)
    if surface_materials and direct:  # Mitsuba puts a sky at the size of a scene that these meshes are not in
        sky = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        event.shadow.tmax = dr.select(sky, dr.inf, event.shadow.tmax)
    radiance = path.beta * event.value * arriving * dr.select(ds.delta, 1, power(ds.pdf, event.p))
    next_shadow = Shadow(
        dr.select(passing, shadow.ray, event.shadow),
        dr.select(passing, shadow.radiance, radiance),
        dr.select(passing, shadow.crosses, wanted & (shell_shadow | ~inside)),
        passing | (wanted & (dr.max(radiance) > 0)),
    )
    return event, origin.p, next_shadow


def _go_on(settings, plan, sampler, path, end, event, p, going, behind: Any) -> Path:
    """Take the path on: after an event at p, or behind what it passes; end it by depth or roulette. behind: lanes that pass
    something, and the distance from which they go on."""
    behind, t = behind
    if plan.onward:
        path = _onward(path, event, going, p)
    strongest = dr.max(path.beta)
    path.alive = dr.select(end.mine, going & mi.Bool(plan.onward) & (strongest > 0), path.alive)
    if plan.surface_materials or plan.hidden:
        path.ray = dr.select(behind, beyond(path.ray, t), path.ray)
        path.alive |= behind
    if not plan.emitters:  # a last segment could only end on an emitter
        path.alive &= path.depth + 1 < plan.max_depth
    if plan.roulette:
        keep = dr.minimum(strongest * dr.square(path.eta), 0.95)
        doomed = end.mine & ~behind & (path.depth >= settings.rr_depth)
        path.beta = dr.select(doomed, path.beta / dr.maximum(keep, 1e-8), path.beta)
        path.alive &= ~doomed | (sampler.next_1d() < keep)
    return path


def _onward(path, event, going, p) -> Path:
    """The path after an event at p, in lanes that are going."""
    return Path(
        dr.select(going, event.ray, path.ray),
        dr.select(going, path.beta * event.weight, path.beta),
        dr.select(going, path.eta * event.eta, path.eta),
        dr.select(going, path.depth + 1, path.depth),
        path.alive,
        dr.select(going, p, path.p),
        dr.select(going, event.pdf, path.pdf),
        dr.select(going, event.delta, path.delta),
    )


def _emitted(settings, scene, si, path, met):
    """Radiance from an emitter that a path hits, weighted against sampling that emitter (multiple importance sampling)."""
    before = dr.zeros(mi.SurfaceInteraction3f)
    before.p = path.p
    p = scene.pdf_emitter_direction(before, mi.DirectionSample3f(scene, si, before), met & ~path.delta)
    share = dr.select(path.delta, 1, power(path.pdf, p))
    visible = met & ~(mi.Bool(settings.hide_emitters) & (path.depth == 0) & ~si.is_valid())
    return dr.select(visible, path.beta * share * si.emitter(scene, met).eval(si, visible), 0)
