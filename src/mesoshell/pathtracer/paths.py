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

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.events import at_collision, at_surface, at_worn, beyond, power, single
from mesoshell.pathtracer.free_flight import fly, still
from mesoshell.pathtracer.quadrature import Ray
from mesoshell.pathtracer.surface_material import nothing_met


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
    """What a path waits for: the segment to an emitter, the light that comes through if all of it does, and whether shells may
    lie between."""

    ray: Ray
    asked: mi.Color3f
    crosses: mi.Bool
    pending: mi.Bool


@dataclass
class PathState:
    """A path, its shadow, the light that it has brought so far, whether it met anything, and samples decoded."""

    path: Path
    shadow: Shadow
    light: mi.Color3f
    seen: mi.Bool
    queries: mi.UInt32


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
    return lane.path.alive | lane.shadow.pending


@dr.syntax
def advance(settings, scene, sampler, lane):
    """One segment: of the shadow that a lane waits for, or of its path."""
    world, rr_depth = settings.world, settings.rr_depth
    names = ("direct_light", "bounces", "shell_shadow", "roulette", "shells", "surface_materials")
    asking, bounces, again, roulette, shells, worn = (getattr(world.effects, name).on for name in names)
    max_depth = settings.max_depth if bounces else min(settings.max_depth, 2)
    hitting = world.effects.environment.on or world.effects.area_light.on
    onward = max_depth > 1 and (bounces or hitting)  # a direction drawn at the last event may meet an emitter
    opening, dark = world.quality.bounce_spread, world.dark
    path, shadow, light, seen = lane.path, lane.shadow, lane.light, lane.seen
    n = dr.width(path.eta)

    # --- the segment: surfaces, then surface materials in front of them, then shells in front of both
    mine = ~shadow.pending
    si = scene.ray_intersect(single(path.ray), mi.RayFlags.All, coherent=mi.Bool(False), active=mine)
    blocked = mi.Bool(False)
    if world.surfaces_shadow:
        blocked = scene.ray_test(single(shadow.ray), active=shadow.pending)
    segment = dr.select(shadow.pending, shadow.ray, path.ray)
    segment.tmax = dr.select(mine & si.is_valid(), mi.Float64(si.t), segment.tmax)
    met = nothing_met(n)
    if worn:
        met = world.worn.meet(segment, mine | ~blocked)
        segment.tmax = dr.select(met.hit, mi.Float64(met.t), segment.tmax)
    flight = still(n)
    if shells:
        target = dr.select(mine, -dr.log(1 - sampler.next_1d()), dark)
        flight = fly(world, segment, target, mine | (shadow.crosses & ~blocked), sampler.next_1d())

    # --- a shadow arrives, goes on behind a surface material, or is stopped
    came = shadow.pending & ~blocked
    passing = came & met.hit
    shadow.asked *= dr.select(came, dr.exp(-mi.Float(flight.depth)), 0)
    light += dr.select(came & ~passing, shadow.asked, 0)
    if worn:
        shadow.asked *= dr.select(met.front, 1 - met.alpha, 1)
        shadow.ray = beyond(shadow.ray, world.worn.beyond(met.t))
        passing &= dr.max(shadow.asked) > 0

    # --- a surface, or the end of the scene, emits toward the path
    collided = mine & flight.collided
    on_worn = mine & ~collided & met.hit
    kept = mi.Bool(False)
    if worn:
        kept = on_worn & met.front & (sampler.next_1d() < met.alpha)
    behind = on_worn & ~kept
    reached = mine & ~collided & ~met.hit
    seen |= collided | kept | (reached & si.is_valid())
    if hitting:
        light += _emitted(settings, scene, si, path, reached)

    # --- the event asks an emitter, and scatters
    going = (collided | kept | (reached & si.is_valid())) & (path.depth + 1 < max_depth)
    inside, wearing, surface = going & collided, going & kept, going & reached
    t = dr.select(inside, flight.sample.t, met.t)
    origin = mi.SurfaceInteraction3f(si)
    origin.p = dr.select(surface, si.p, mi.Point3f(path.ray.o + mi.Float64(t) * path.ray.d))
    ds = dr.zeros(mi.DirectionSample3f, n)
    arriving = dr.zeros(mi.Color3f, n)
    if asking:
        smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        ds, arriving = scene.sample_emitter_direction(
            origin, sampler.next_2d(), False, inside | wearing | (surface & smooth)
        )
    wanted = going & (ds.pdf != 0)
    numbers = (sampler.next_1d(), sampler.next_2d()) if onward else None
    event = at_surface(si, path.ray, ds, surface & wanted, surface, numbers, opening)
    if shells and inside:
        event = at_collision(world, flight, path.ray, ds, numbers and numbers[1], opening)
    if worn and wearing:
        event = at_worn(world, met, path.ray, ds, numbers and numbers[1], opening)
    if worn and asking:  # how far a sky is Mitsuba says by the size of a scene that these meshes are not in
        sky = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        event.shadow.tmax = dr.select(sky, dr.inf, event.shadow.tmax)
    asked = path.beta * event.value * arriving * dr.select(ds.delta, 1, power(ds.pdf, event.p))
    shadow = Shadow(
        dr.select(passing, shadow.ray, event.shadow),
        dr.select(passing, shadow.asked, asked),
        dr.select(passing, shadow.crosses, wanted & (mi.Bool(again) | ~inside)),
        passing | (wanted & (dr.max(asked) > 0)),
    )

    # --- the path goes on
    if onward:
        path = _onward(path, event, going, origin.p)
    strongest = dr.max(path.beta)
    path.alive = dr.select(mine, going & mi.Bool(onward) & (strongest > 0), path.alive)
    if worn:
        path.ray = dr.select(behind, beyond(path.ray, world.worn.beyond(met.t)), path.ray)
        path.alive |= behind
    if not hitting:  # a last segment could only end on an emitter
        path.alive &= path.depth + 1 < max_depth
    if roulette:
        keep = dr.minimum(strongest * dr.square(path.eta), 0.95)
        doomed = mine & ~behind & (path.depth >= rr_depth)
        path.beta = dr.select(doomed, path.beta / dr.maximum(keep, 1e-8), path.beta)
        path.alive &= ~doomed | (sampler.next_1d() < keep)
    return PathState(path, shadow, light, seen, lane.queries + flight.queries)


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
    """What arrives along a path from the emitter that it has met, by its share against having been asked for."""
    before = dr.zeros(mi.SurfaceInteraction3f)
    before.p = path.p
    p = scene.pdf_emitter_direction(before, mi.DirectionSample3f(scene, si, before), met & ~path.delta)
    share = dr.select(path.delta, 1, power(path.pdf, p))
    visible = met & ~(mi.Bool(settings.hide_emitters) & (path.depth == 0) & ~si.is_valid())
    return dr.select(visible, path.beta * share * si.emitter(scene, met).eval(si, visible), 0)
