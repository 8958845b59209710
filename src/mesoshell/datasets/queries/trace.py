"""Light traced through a mesostructure on a cylinder, in Mitsuba: the answers that a surface material learns.

Notation
P, ω, ω′     where a ray meets the bounding surface; unit directions toward the viewer and the light, in the frame there
α            1 if the ray meets the mesostructure, 0 if it leaves through the bounding surface first
L / E⊥       radiance toward ω over the irradiance of a distant light on the plane facing it, all bounces          1/sr
c            the silhouette cosine: rays in the plane of ω and the normal with a smaller ω_z meet nothing
f            albedo / π of a point, diffuse from both sides

Rays begin on the bounding surface, and end where they leave through it: the renderer computes light between parts of an object.
So the inside of a cylinder, whose rays would meet the opposite wall, does not shade itself.
"""

from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

import mesoshell.pathtracer  # noqa: F401  (sets the variant)
from mesoshell.datasets.queries.tile import PatchPlacement, Tile, bent, frame, patch
from mesoshell.render.mitsuba_frame import fitting_grid
from mesoshell.render.sequence import GOLDEN

import drjit as dr  # isort: skip  (after mesoshell.pathtracer)
import mitsuba as mi  # isort: skip

#: Offset of ray origins from surfaces, texture units; steps of the search for c; bounces before roulette, and at most.
AWAY, HALVINGS, SURE, MAX_BOUNCES = 2e-5, 14, 4, 64


class Patch:
    """A bent patch of a tile, ready for rays."""

    def __init__(self, tile: Tile, placing: PatchPlacement, reach: tuple[float, float]):
        points, faces, albedo = patch(tile, placing, reach)
        self.curvature = placing.curvature
        mesh = mi.Mesh("patch", len(points), len(faces))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
        parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        parameters.update()
        self.scene: Any = mi.load_dict({"type": "scene", "patch": mesh})
        corner = points[faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        self.normal = mi.Float(normal.astype(np.float32).ravel())
        self.faces = mi.UInt32(faces.astype(np.uint32).ravel())
        self.albedo = mi.Float(albedo.astype(np.float32).ravel())

    def meet(self, o, d):
        """The nearest point along rays: whether there is one, its distance, normal against the ray, and f."""
        intersection = self.scene.ray_intersect_preliminary(self.ray(o, d), coherent=mi.Bool(False))
        hit = intersection.is_valid()
        face = dr.select(hit, intersection.prim_index, 0)
        n = dr.gather(mi.Normal3f, self.normal, face)
        n = dr.select(dr.dot(n, d) > 0, -n, n)
        i = dr.gather(mi.Vector3u, self.faces, face)
        a, b, c = (mi.Color3f(dr.gather(mi.Vector3f, self.albedo, k)) for k in (i.x, i.y, i.z))
        u, v = intersection.prim_uv.x, intersection.prim_uv.y
        return hit, intersection.t, n, dr.inv_pi * ((1 - u - v) * a + u * b + v * c)

    def hidden(self, o, d, active=True):
        """Whether rays from these points meet anything before they leave."""
        return self.scene.ray_test(self.ray(o, d), active)

    def ray(self, o, d):
        now: Any = 0.0
        none: Any = []
        return mi.Ray3f(o, d, self.leave(o, d), now, none)

    def leave(self, o, d) -> Any:
        """Distance at which a ray leaves through a bounding surface seen from within; infinite for others."""
        if self.curvature >= 0:
            return mi.Float(dr.inf)
        k = mi.Float(-self.curvature)
        # x² + (z − 1/κ)² = 1/κ² times κ: the axis lies at z = 1/κ
        a = k * (dr.square(d.x) + dr.square(d.z))
        b = k * (o.x * d.x + o.z * d.z) - d.z
        c = k * (dr.square(o.x) + dr.square(o.z)) - 2 * o.z
        root = b * b - a * c
        near = dr.maximum(c, 0) / dr.maximum(-b + dr.sqrt(dr.maximum(root, 0)), 1e-12)
        return dr.select((root > 0) & (b < 0), near, dr.inf)


def light_of(patch: Patch, o, toward, light, sampler):
    """α and L / E⊥ of rays from o against `toward`, under light from `light`."""
    hit, t, n, f = patch.meet(o, -toward)
    return hit, bounced(patch, (hit, o - t * toward, n, f), light, sampler)


@no_type_check
@dr.syntax
def bounced(patch, met, light, sampler):
    """L / E⊥ of the points that rays met."""
    alive, p, n, f = met
    total, beta, bounce = mi.Color3f(0), mi.Color3f(1), mi.UInt32(0)
    alive, p, n, f = mi.Bool(alive), mi.Point3f(p), mi.Normal3f(n), mi.Color3f(f)
    while alive:
        o = mi.Point3f(p + AWAY * n)
        cosine = dr.dot(n, light)
        lit = alive & (cosine > 0)
        lit &= ~patch.hidden(o, light, lit)
        total += dr.select(lit, beta * f * cosine, 0)
        beta *= f * dr.pi
        bounce += 1
        keep = dr.select(bounce < SURE, 1, dr.minimum(dr.max(beta), 0.95))
        alive &= (sampler.next_1d() < keep) & (bounce < MAX_BOUNCES)
        beta /= dr.maximum(keep, 1e-8)
        d = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        hit, t, normal, albedo = patch.meet(o, d)
        alive &= hit
        p, n, f = mi.Point3f(o + t * d), mi.Normal3f(normal), mi.Color3f(albedo)
    return total


@no_type_check
@dr.syntax
def silhouette(patch, o, across, normal):
    """c of rays through o in the plane of the unit vectors `across` and `normal`, by halving; 0 if all meet something."""
    low, high, k = dr.zeros(mi.Float, dr.width(o)), dr.full(mi.Float, 1, dr.width(o)), mi.UInt32(0)
    while k < HALVINGS:
        c = 0.5 * (low + high)
        d = -(c * normal + dr.sqrt(1 - c * c) * across)
        met = patch.hidden(o, d)
        low, high = dr.select(met, low, c), dr.select(met, c, high)
        k += 1
    return dr.select(low > 0, 0.5 * (low + high), 0)


def queries(
    patch: Patch, placing: PatchPlacement, query: dict[str, np.ndarray], spp: int, seed: int
) -> dict[str, Float[np.ndarray, "Q *c"]]:
    """alpha, cosine and reflectance of queries, each the mean of spp rays from places that lie evenly about its own.

    query: `place` (s, y) on the bounding surface, `radius`, a standard deviation about it there, `toward` and `light`, in the
    frame of each ray's own place (Q, 3).
    """
    count = len(query["radius"])
    even = "multijitter" if fitting_grid(spp) == spp else "independent"
    sampler = mi.load_dict({"type": even, "sample_count": spp})
    sampler.set_samples_per_wavefront(spp)
    sampler.seed(seed, count * spp)
    many = {name: np.repeat(x, spp, axis=0) for name, x in query.items()}
    about = normal_lattice(count, spp, np.random.default_rng(seed)).reshape(-1, 2)
    place = many["place"] + many["radius"][:, None] * about
    axes = frame(place, placing.curvature)
    origin = bent(place, np.zeros(len(place)), placing.curvature)
    toward, light = (np.einsum("qi,qij->qj", many[name], axes) for name in ("toward", "light"))
    # begin above the bounding surface, so that rays meet geometry at h = 0
    o, d, l = (_vectors(x) for x in (origin + AWAY * axes[:, 2], toward, light))
    o = mi.Point3f(o)
    hit, radiance = light_of(patch, o, d, l, sampler)
    mean = lambda x: x.reshape(count, spp, -1).mean(axis=1)  # noqa: E731
    first = slice(None, None, spp)
    level = many["toward"][first] * np.array([1.0, 1.0, 0.0])
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-12)
    across = np.einsum("qi,qij->qj", level, axes[first])
    place = mi.Point3f(np.array(o).T[first].T)
    cosine = silhouette(patch, place, _vectors(across), _vectors(axes[first, 2]))
    return {
        "alpha": mean(np.array(hit, np.float32)),
        "cosine": np.array(cosine)[:, None],
        "reflectance": mean(np.array(radiance).T),
    }


def normal_lattice(count: int, samples: int, random: np.random.Generator) -> Float[np.ndarray, "Q S 2"]:
    """Pairs of standard normal numbers: for each query a lattice that covers the square evenly, shifted at random."""
    k = np.arange(samples)
    lattice = np.stack([k / samples, k * GOLDEN], axis=1)
    u = (lattice + random.random((count, 1, 2))) % 1.0
    return ndtri(np.clip(u, 1e-7, 1 - 1e-7))


def _vectors(x: np.ndarray) -> mi.Vector3f:
    return mi.Vector3f(np.ascontiguousarray(x.T, np.float32))
