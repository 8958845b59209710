"""What happens to a path where it meets something: an emitter is sampled, and the path scatters.

Notation
value, p    f cos θ of a surface, or ρ of a collision, toward an emitter; the density with which the event draws that direction
weight      value over density of the direction that the event has drawn
pdf         density of that direction, 1/sr
ṙ, a        a cone's radius at t is ṙ (t + a): after an event as wide as it was, then opening as much as a draw of that density
            can stand for: a circle of solid angle 1/pdf, times `Quality.bounce_spread`

A collision scatters with ρ(ω, ω′), which holds all that happens inside the shell: light comes from, and the path goes on at,
the point where ω′ leaves the shell's top. From there on other shells, and this one if it is met again, count like any; but that
point is taken to lie outside them all, so where two shells overlap, the rest of the other one is passed.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.samples import Ray, canonical
from mesoshell.pathtracer.scatter import density, draw, exit_distance
from mesoshell.pathtracer.surface_material import density_around, draw_around
from mesoshell.pathtracer.traversal import ADVANCE

#: Of a shadow's way, what is left out at the emitter, which would block it: of its length, and of its coordinates.
SHADOW_EPSILON, SHADOW_ULPS = 1e-4, 2.0**-19
#: Step off a surface: of its coordinates, and of all that stands there, whose triangles may be as large.
ULPS, EXTENT_ULPS = 2.0**-21, 2.0**-19
#: Mitsuba's own step off a surface, relative to 1 + the greatest coordinate.
MITSUBA_EPSILON = 1500 * 2.0**-24


@dataclass
class Event:
    """value, p: toward the emitter that was sampled; shadow: the way to it; ray: the way on."""

    value: mi.Color3f
    p: mi.Float
    shadow: Ray
    weight: mi.Color3f
    pdf: mi.Float
    delta: mi.Bool
    eta: mi.Float
    ray: Ray


def at_surface(context, si, ray, ds, wanted, active, numbers, opening) -> Event:
    """A BSDF scatters. numbers: one and two uniform ones, or none if the path ends here."""
    plain, bsdf = mi.BSDFContext(), si.bsdf()
    value, p = bsdf.eval_pdf(plain, si, si.to_local(ds.d), wanted)
    begin, far = off_surface(si, ds.d, context.extent), shadow_length(ds, si.p)
    shadow = segment(ray, si.t, begin, ds.d, far, False, dr.select(ds.delta, 0, opening), ds.pdf)
    if numbers is None:
        return last(value, p, shadow)
    chosen, weight = bsdf.sample(plain, si, numbers[0], numbers[1], active)
    delta = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
    d = mi.Vector3f(si.to_world(chosen.wo))
    begin = off_surface(si, d, context.extent)
    onward = segment(ray, si.t, begin, d, dr.inf, False, dr.select(delta, 0, opening), chosen.pdf)
    return Event(
        mi.Color3f(value),
        mi.Float(p),
        shadow,
        mi.Color3f(weight),
        mi.Float(chosen.pdf),
        delta,
        mi.Float(chosen.eta),
        onward,
    )


def off_surface(si, d, extent):
    """Where a ray in a direction leaves a surface. Mitsuba's `spawn_ray` begins far enough off it for any shape: in large
    scenes beyond a thin shell, which would then not shadow its ground. extent: of all that stands there."""
    reach = dr.max(dr.abs(si.p))
    off = dr.minimum(MITSUBA_EPSILON * (1 + reach), ULPS * reach + EXTENT_ULPS * extent)
    return mi.Vector3d(si.p) + mi.Vector3d(dr.mulsign(off, dr.dot(si.n, d)) * si.n)


def shadow_length(ds, p):
    """How far a shadow from p goes toward an emitter."""
    return ds.dist - dr.maximum(SHADOW_EPSILON * ds.dist, SHADOW_ULPS * dr.max(dr.abs(p)))


def at_collision(context, flight, ray, ds, numbers, opening) -> Event:
    """A shell scatters. numbers: two uniform ones, or none if the path ends here."""
    frame, sample = flight.frame, flight.sample
    size = mi.Float(context.shells.size)
    x = ray.o + mi.Float64(sample.t) * ray.d
    view = dr.normalize(canonical(frame, -mi.Vector3f(ray.d)))
    toward = dr.normalize(canonical(frame, ds.d))
    _, features = context.media.decode(sample, context.taps)

    def away(d, far, opening, pdf):
        leave = exit_distance(frame, sample.xi.z, d, size) + ADVANCE * size
        return segment(ray, sample.t, x + mi.Vector3d(leave * d), d, dr.maximum(far - leave, 0), True, opening, pdf)

    def rho(directions):
        return context.media.rho(sample, features, view, directions)

    drawn = None if numbers is None else draw(frame, numbers)
    return scatter_event(ds, shadow_length(ds, x), toward, density(frame, ds.d), rho, drawn, away, opening)


def at_surface_material(context, met, ray, ds, numbers, opening) -> Event:
    """A surface material scatters. numbers: as of a collision."""
    frame = met.frame
    x = ray.o + mi.Float64(met.t) * ray.d

    def away(d, far, opening, pdf):
        # by the face's own normal: over the horizon of an interpolated one there is light that comes through the face
        off = dr.select(dr.dot(met.normal, d) < 0, -1, 1) * (context.surface_meshes.beyond(met.t) - met.t)
        return segment(ray, met.t, x + mi.Vector3d(off * met.normal), d, far, False, opening, pdf)

    toward = canonical(frame, ds.d)

    def rho(directions):
        return context.surface_meshes.rho(met, directions)

    drawn = None if numbers is None else draw_around(frame, numbers)
    return scatter_event(ds, shadow_length(ds, x), toward, density_around(frame, ds.d), rho, drawn, away, opening)


def scatter_event(ds, far, toward, p, rho, drawn, away, opening) -> Event:
    """far: as `shadow_length`; toward, p: the emitter's direction in the material's frame, and its density; rho: of directions;
    drawn: a direction, it in that frame, and its density; or none if the path ends here; away: the segment from here in a
    direction."""
    shadow = away(ds.d, far, dr.select(ds.delta, 0, opening), ds.pdf)
    if drawn is None:
        (value,) = rho([toward])
        return last(value, p, shadow)
    d, local, pdf = drawn
    value, weight = rho([toward, local])
    weight = dr.select(pdf > 0, weight / dr.select(pdf > 0, pdf, 1), 0)
    return Event(
        mi.Color3f(value),
        p,
        shadow,
        mi.Color3f(weight),
        mi.Float(pdf),
        mi.Bool(False),
        mi.Float(1),
        away(d, dr.inf, opening, pdf),
    )


def last(value, p, shadow: Ray) -> Event:
    """An event at which a path ends: no direction is drawn."""
    none = mi.Float(0)
    return Event(mi.Color3f(value), mi.Float(p), shadow, mi.Color3f(0), none, mi.Bool(False), mi.Float(1), shadow)


def power(a, b):
    """The power heuristic's share of a."""
    a, b = a * a, b * b
    return dr.select(a + b > 0, a / dr.select(a + b > 0, a + b, 1), 0)


def segment(ray, t, o, d, tmax=dr.inf, outside=False, opening: Any = 0.0, pdf: Any = 1.0) -> Ray:
    """A segment that begins where another came to, at t."""
    radius = ray.spread * (t + ray.apex)
    spread = dr.maximum(ray.spread, dr.minimum(opening * dr.sqrt(dr.inv_pi / dr.maximum(mi.Float(pdf), 1e-6)), 1))
    apex = dr.select(spread > 0, radius / dr.select(spread > 0, spread, 1), 0)
    n = dr.width(spread)
    return Ray(
        mi.Vector3d(o),
        mi.Vector3d(d),
        dr.zeros(mi.Float64, n),
        mi.Float64(tmax) + dr.zeros(mi.Float64, n),
        dr.full(mi.Bool, outside, n),
        mi.Float(spread),
        mi.Float(apex),
    )


def beyond(ray: Ray, t) -> Ray:
    """The rest of a segment from t on."""
    n = dr.width(ray.spread)
    d: Any = ray.d
    o = ray.o + d * mi.Float64(t)
    outside = dr.full(mi.Bool, False, n)
    return Ray(
        o,
        mi.Vector3d(ray.d),
        dr.zeros(mi.Float64, n),
        ray.tmax - mi.Float64(t),
        outside,
        mi.Float(ray.spread),
        ray.apex + t,
    )


def single(ray: Ray) -> mi.Ray3f:
    """As Mitsuba takes it."""
    rest: Any = mi.Float(ray.tmax), mi.Float(0), []
    return mi.Ray3f(mi.Point3f(ray.o), mi.Vector3f(ray.d), *rest)
