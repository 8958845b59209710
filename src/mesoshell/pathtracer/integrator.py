"""Path tracing through a scene with shells: next-event estimation, and MIS over all emitters.

Alphabet
β           throughput of the path so far                                        RGB
segment     of a path, from one event to the next; or of a shadow, from an event to an emitter
ω, ω′       canonical directions toward where the path came from, and on          (3,)

A lane follows its path segment by segment; what it asks of an emitter is a segment too, taken before the path goes on. So all
flights through shells, of paths and of shadows, are one piece of the compiled program. An event is a collision in a shell, a
surface, or the end of the scene.

A collision scatters with ρ(ω, ω′), which holds all that happens inside the shell: light comes from, and the path goes on at,
the point where ω′ leaves the shell's top. From there on other shells, and this one if it is met again, count like any.
"""

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.flight import fly
from mesoshell.pathtracer.march import ADVANCE
from mesoshell.pathtracer.quadrature import Ray, canonical
from mesoshell.pathtracer.scatter import density, draw, exit_distance


class ShellPath(mi.SamplingIntegrator):
    """`mesoshell_path`: max_depth and rr_depth as of Mitsuba's `path`. world: set by whoever made the scene."""

    def __init__(self, props):
        super().__init__(props)
        depth = int(props.get("max_depth", -1))
        self.max_depth = 2**31 if depth < 0 else depth
        self.rr_depth = int(props.get("rr_depth", 5))
        self.world = None

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        world, max_depth, rr_depth = self.world, self.max_depth, self.rr_depth
        context = mi.BSDFContext()
        n = dr.width(ray.o)
        o, d = mi.Point3f(ray.o), mi.Vector3f(ray.d)
        outside = dr.full(mi.Bool, world.camera_outside, n)
        spread = world.cone(ray, sampler)
        apex = dr.zeros(mi.Float, n)
        light, beta, eta = dr.zeros(mi.Color3f, n), dr.full(mi.Color3f, 1, n), dr.full(mi.Float, 1, n)
        depth, alive = dr.zeros(mi.UInt32, n), mi.Bool(active) & dr.full(mi.Bool, True, n)
        last_p, last_pdf, last_delta = mi.Point3f(o), dr.full(mi.Float, 1, n), dr.full(mi.Bool, True, n)
        shadow, asked = dr.full(mi.Bool, False, n), dr.zeros(mi.Color3f, n)
        shadow_o, shadow_d, shadow_max = mi.Point3f(o), mi.Vector3f(d), dr.zeros(mi.Float, n)
        shadow_outside = dr.full(mi.Bool, True, n)
        seen = dr.full(mi.Bool, False, n)

        while alive | shadow:
            # --- the segment: surfaces, then shells in front of them
            path = ~shadow
            si = scene.ray_intersect(mi.Ray3f(o, d), mi.RayFlags.All, coherent=mi.Bool(False), active=path)
            blocked = scene.ray_test(mi.Ray3f(shadow_o, shadow_d, shadow_max, 0.0, []), active=shadow)
            tmax = dr.select(shadow, shadow_max, dr.select(si.is_valid(), si.t, dr.inf))
            segment = Ray(
                mi.Vector3d(dr.select(shadow, shadow_o, o)),
                mi.Vector3d(dr.select(shadow, shadow_d, d)),
                dr.zeros(mi.Float64, n),
                mi.Float64(tmax),
                dr.select(shadow, shadow_outside, outside),
                spread,
                apex,
            )
            target = dr.select(shadow, dr.inf, -dr.log(1 - sampler.next_1d()))
            flight = fly(world, segment, target, (path | world.shell_shadows) & ~blocked)
            collided = path & flight.collided

            # --- a shadow arrives, or it does not
            light += dr.select(shadow & ~blocked, asked * dr.exp(-flight.depth), 0)
            asked = dr.select(shadow, 0, asked)
            shadow = mi.Bool(False)

            # --- what a surface, or the end of the scene, emits toward the path
            met = path & ~collided
            seen |= path & (collided | si.is_valid())
            before = dr.zeros(mi.SurfaceInteraction3f)
            before.p = last_p
            toward = mi.DirectionSample3f(scene, si, before)
            emitter = si.emitter(scene, met)
            p_light = scene.pdf_emitter_direction(before, toward, met & ~last_delta)
            share = dr.select(last_delta, 1, _power(last_pdf, p_light))
            visible = met & ~(world.hide_emitters & (depth == 0) & ~si.is_valid())
            light += dr.select(visible, beta * share * emitter.eval(si, visible), 0)
            onward = (depth + 1 < max_depth) & (collided | si.is_valid())
            going = path & onward

            # --- a surface scatters
            at_surface = going & ~collided
            bsdf = si.bsdf(mi.RayDifferential3f(mi.Ray3f(o, d)))
            smooth = at_surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            inside = going & collided
            here, sample = flight.here, flight.sample
            x = mi.Point3f(mi.Vector3d(o) + mi.Float64(sample.t) * mi.Vector3d(d))
            origin = dr.zeros(mi.SurfaceInteraction3f)
            origin.p = dr.select(inside, x, si.p)
            origin.n, origin.sh_frame, origin.wi = si.n, si.sh_frame, si.wi
            origin.time, origin.t = si.time, si.t
            ds, weight = scene.sample_emitter_direction(origin, sampler.next_2d(), False, smooth | inside)
            wanted = (ds.pdf != 0) & (smooth | inside)
            local = si.to_local(ds.d)
            value, p_value = bsdf.eval_pdf(context, si, local, smooth & wanted)
            chosen, value_on = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), at_surface)
            next_d = mi.Vector3f(si.to_world(chosen.wo))
            next_o = mi.Point3f(si.spawn_ray(next_d).o)
            lit = si.spawn_ray_to(ds.p)
            shadow_o, shadow_d, shadow_max = mi.Point3f(lit.o), mi.Vector3f(lit.d), mi.Float(lit.maxt)
            shadow_outside, next_outside = mi.Bool(False), mi.Bool(False)
            next_pdf, next_delta = mi.Float(chosen.pdf), mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
            next_eta = mi.Float(chosen.eta)
            numbers = sampler.next_2d()

            # --- a collision scatters
            if inside:
                view = dr.normalize(canonical(here, -d))
                drawn, drawn_local, p_drawn = draw(here, numbers)
                rho_light = world.media.rho(sample, view, dr.normalize(canonical(here, ds.d)))
                rho_drawn = world.media.rho(sample, view, drawn_local)
                value, p_value = rho_light, density(here, ds.d)
                value_on = dr.select(p_drawn > 0, rho_drawn / dr.select(p_drawn > 0, p_drawn, 1), 0)
                leave = exit_distance(here, sample, ds.d, world.shells.size) + ADVANCE * world.shells.size
                shadow_o, shadow_d = mi.Point3f(x + leave * ds.d), mi.Vector3f(ds.d)
                shadow_max = dr.maximum(ds.dist * (1 - 1e-4) - leave, 0)
                leave_on = exit_distance(here, sample, drawn, world.shells.size) + ADVANCE * world.shells.size
                next_o, next_d = mi.Point3f(x + leave_on * drawn), mi.Vector3f(drawn)
                shadow_outside, next_outside = mi.Bool(True), mi.Bool(True)
                next_pdf, next_delta, next_eta = p_drawn, mi.Bool(False), mi.Float(1)

            share = dr.select(ds.delta, 1, _power(ds.pdf, p_value))
            asked = dr.select(wanted, beta * value * weight * share, asked)
            shadow = wanted & (dr.max(asked) > 0)

            # --- the path goes on
            beta = dr.select(going, beta * value_on, beta)
            eta = dr.select(going, eta * next_eta, eta)
            o, d = dr.select(going, next_o, o), dr.select(going, next_d, d)
            outside = dr.select(going, next_outside, outside)
            last_p = dr.select(going, dr.select(inside, x, si.p), last_p)
            last_pdf, last_delta = dr.select(going, next_pdf, last_pdf), dr.select(going, next_delta, last_delta)
            depth = dr.select(going, depth + 1, depth)
            strongest = dr.max(beta)
            alive = dr.select(path, going & (strongest > 0), alive)
            keep = dr.minimum(strongest * dr.square(eta), 0.95)
            doomed = path & (depth >= rr_depth)
            beta = dr.select(doomed, beta / dr.maximum(keep, 1e-8), beta)
            alive &= ~doomed | (sampler.next_1d() < keep)
        return light, seen, []


def _power(a, b):
    """The power heuristic's share of a."""
    a, b = a * a, b * b
    return dr.select(a + b > 0, a / dr.select(a + b > 0, a + b, 1), 0)


def register() -> None:
    mi.register_integrator("mesoshell_path", ShellPath)
