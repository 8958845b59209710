"""Light that a shell scatters toward a ray from distant lights alone: a sum over all samples in place of a drawn one.

Notation
τ, T, w     optical depth of a sample, transmittance before it, its weight T (1 − e^{−τ})
E⊥          irradiance of a distant light on the plane facing it                    RGB
V           visibility of a light, from the exit point on the shell's top

Σ w ρ(ω, ω′) E⊥ V, as the JAX engine sums it. In pictures each ray's samples begin at a random offset, as those of flights do:
samples always in the middle of their steps would show as ladders on blades along the ray.
"""

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.events import off_surface, segment, single
from mesoshell.pathtracer.facts import distant
from mesoshell.pathtracer.free_flight import fly
from mesoshell.pathtracer.quadrature import begin, seek
from mesoshell.pathtracer.samples import canonical
from mesoshell.pathtracer.scatter import exit_distance
from mesoshell.pathtracer.traversal import ADVANCE


@dr.syntax
def gather_light(context, scene, ray, lights=(), shift=0.5):
    """Radiance toward a ray from what it passes, its transmittance, and the count of decoded samples. lights: direction toward
    each, and E⊥; shift: as in `begin`."""
    s = begin(context, ray, shift)
    n = dr.width(ray.o)
    depth, rgb, queries = dr.zeros(mi.Float64, n), dr.zeros(mi.Color3f, n), dr.zeros(mi.UInt32, n)
    cut, stop = context.quality.least_weight, context.dark
    busy = dr.full(mi.Bool, True, n)
    while busy:
        s, sample, occupied = seek(context, ray, s)
        busy = occupied
        if occupied:
            sigma, features = context.media.decode(sample, context.taps)
            tau = dr.minimum(sigma, 1e20) * mi.Float(s.step)
            weight = dr.exp(-mi.Float(depth)) * opacity(tau)
            depth += mi.Float64(tau)
            queries += 1
            busy = depth < stop
            if weight > cut:
                rgb += weight * single_scattering(context, scene, ray, s.frame, sample, features, lights)
    return rgb, dr.exp(-mi.Float(depth)), queries


def single_scattering(context, scene, ray, frame, sample, features, lights):
    """Σ ρ E⊥ V at a sample, from its trunk features."""
    total = mi.Color3f(0)
    view = dr.normalize(canonical(frame, -mi.Vector3f(ray.d)))
    at, height = sample.t, sample.xi.z
    if context.quality.visibility == "interval":
        at, height = 0.5 * (frame.t0 + frame.t1), 0.5 * (frame.xi0.z + frame.xi1.z)
    rhos = context.media.rho(sample, features, view, [dr.normalize(canonical(frame, d)) for d, _ in lights])
    size = mi.Float(context.shells.size)
    for rho, (toward, irradiance) in zip(rhos, lights, strict=True):
        leave = exit_distance(frame, height, toward, size) + ADVANCE * size
        lit = rho * irradiance
        if context.surfaces_shadow:
            x = mi.Point3f(ray.o + mi.Float64(at) * ray.d) + leave * toward
            lit = dr.select(scene.ray_test(mi.Ray3f(x, toward)), 0, lit)
        total += lit
    return total


def opacity(tau):
    """1 − e^{−τ}, by a series where digits would cancel."""
    series = mi.Float(1)
    for k in range(7, 1, -1):
        series = 1 - tau / k * series
    return dr.select(tau < 0.5, tau * series, 1 - dr.exp(-tau))


def light_directly(settings, scene, sampler, ray, active):
    """Radiance toward rays by distant lights and one event, and whether they met anything. settings: a ShellPath."""
    context, first = settings.context, ray
    lights = [distant(e) for e in scene.emitters()]
    si = scene.ray_intersect(single(ray), active)
    met = si.is_valid()
    first.tmax = dr.select(met, mi.Float64(si.t), dr.inf)
    light, through, queries = gather_light(context, scene, first, lights, sampler.next_1d())
    bsdf = si.bsdf()
    for toward, irradiance in lights:
        value = bsdf.eval(mi.BSDFContext(), si, si.to_local(toward), met) * irradiance
        lit = met & (dr.max(value) > 0)
        away = segment(first, si.t, off_surface(si, toward, context.extent), toward)
        if context.surfaces_shadow:
            lit &= ~scene.ray_test(single(away), lit)
        dimmed = fly(context, away, dr.inf, lit, sampler.next_1d())
        queries += dimmed.queries
        light += dr.select(lit, through * value * dr.exp(-mi.Float(dimmed.depth)), 0)
    context.count(queries)
    return light, met | (sampler.next_1d() > through)
