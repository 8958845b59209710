"""Checks of a mesh with a surface material: where rays meet it, its curvature, and its network.

Notation
p           period of the texture: the unit of lengths here                              world
P           the place of a hit, by its face and barycentric coordinates                  (3,), world
α, ρ        opacity and reflectance of a query (surface_material/network)
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mesoshell.geometry.curvature import range_of
from mesoshell.render.camera import Camera
from mesoshell.render.quality import PRESETS
from mesoshell.stability import rays as of
from mesoshell.stability.checks import Check
from mesoshell.stability.rays import Rays
from mesoshell.stability.surface import of_grid, of_mesh
from mesoshell.stability.walks import OFF, SHIFT, rare
from mesoshell.surface_material.intersector import Hits, SurfaceIntersector
from mesoshell.surface_material.loader import DeviceMaterial
from mesoshell.surface_material.network import BlurredSurface, SurfaceConfig, SurfaceQuery, eval_opacity, reflectance
from mesoshell.surface_material.scene import SurfaceDescription
from mesoshell.surface_material.tables import surface_tables
from mesoshell.typing import Array

#: Of rays aimed at vertices and edges, those that may go through: Embree's float32 loses one in 200 of those at vertices. How
#: near in sizes of the mesh a hit is the surface that was aimed at.
LEAKS, NEAR = 1e-2, 1e-5
#: Rays of the camera that float64 intersects with all triangles, three of four of them where it sees one; pairs of both, and at
#: once; share that may meet another surface.
EXACT, PAIRS, AT_ONCE, OTHER = 2000, 2**27, 2**22, 2e-3
#: What float32 loses of a distance.
ROUNDING = 2.0**-20
#: Queries of the network, and the greatest error of α, and of αρ over its greatest value.
POINTS, ERROR = 20_000, 1e-4


def of_surface_material(
    d: SurfaceDescription, device_material: DeviceMaterial, camera: Camera, count: int, rng: np.random.Generator
) -> tuple[list[Check], Int[np.ndarray, "H W"], Float[np.ndarray, "F"]]:
    """The checks; the face that each pixel of the camera sees first, from outside, −1 for none; and of each face the worst
    place, over what it may be. count: rays that are aimed at the front of vertices and edges."""
    tables = surface_tables(d.mesh, d.period, PRESETS["normal"])
    others = [m.vertices[m.faces].astype(np.float64) for m in d.objects]
    meets = SurfaceIntersector(tables, np.concatenate([np.zeros((0, 3, 3)), *others]))
    seen = of.of_camera(camera, np.arange(camera.width * camera.height), rng)
    hits = meets.meet(seen.o, seen.d)
    excess = np.zeros(len(meets.corners))
    low, high = (d.period * x for x in range_of(tables.table))
    told = "; ".join(tables.notes(device_material.curvature)) or f"{low:.2g} to {high:.2g} per period, as trained"
    checks = [
        of_mesh(d.mesh),
        of_grid(d.mesh.vertices, d.period, "period"),
        _of_front(meets, of.at_the_front(d.mesh, count, rng)),
        _of_places(meets, seen, hits, d.period, excess),
        _of_hits(meets, seen, hits, d.period, rng),
        Check("curvature", told, 0.0, None),
        *_of_network(device_material, rng),
    ]
    first = np.where(hits.front & (hits.face < meets.count), hits.face, -1)
    return checks, first.reshape(camera.height, camera.width), excess[: meets.count]


def _of_front(meets: SurfaceIntersector, front: Rays) -> Check:
    if not len(front.d):
        return Check("surface", "no vertex or edge has faces all around", 0.0, None)
    through = passing(meets.meet(front.o, front.d), front, NEAR * meets.size)
    line = f"{through.sum()} of {len(through)} rays at the front of its vertices and edges go through the surface"
    return rare("surface", line, through.sum(), len(through), LEAKS)


def passing(hits: Hits, front: Rays, near: float) -> np.ndarray:
    """Rays that pass a point of the surface which they meet from the front. near: how far is there. What is met before is not
    judged: of an open mesh it may be another part's back."""
    inside = ~hits.front & (np.abs(hits.t - front.surface) <= near)
    return (hits.face < 0) | (hits.t > front.surface + near) | inside


def _of_places(meets: SurfaceIntersector, seen: Rays, hits: Hits, p: float, excess: np.ndarray) -> Check:
    """How far P lies off its ray."""
    met = hits.face >= 0
    place = np.einsum("rk,rki->ri", hits.bary[met], meets.corners[hits.face[met]])
    off = np.linalg.norm(np.cross(place - seen.o[met], seen.d[met]), axis=1) / p
    np.maximum.at(excess, hits.face[met], np.nan_to_num(off / OFF, nan=np.inf))
    line = f"places lie off the camera's rays by {off.max(initial=0):.1g} of the period at most"
    return Check("places", line, float(off.max(initial=0)), OFF)


def _of_hits(meets: SurfaceIntersector, seen: Rays, hits: Hits, p: float, rng: np.random.Generator) -> Check:
    count = max(1, min(EXACT, PAIRS // len(meets.corners)))
    some, rest = (rng.permutation(np.flatnonzero(x)) for x in (hits.face >= 0, hits.face < 0))
    chosen = np.concatenate([some[: -(-3 * count // 4)], rest[: count // 4]])
    exact = nearest(meets.corners, seen.o[chosen], seen.d[chosen])
    found = np.where(hits.face[chosen] < 0, np.inf, hits.t[chosen])
    both = np.isfinite(found) & np.isfinite(exact)
    apart = np.subtract(found, exact, out=np.zeros(len(exact)), where=both)
    near = (
        OFF * p + SHIFT * meets.size + ROUNDING * np.where(both, exact, 0)
    )  # distances are float32's, from the camera on
    other = (np.isfinite(found) != np.isfinite(exact)) | (np.abs(apart) > near)
    tried = int((np.isfinite(found) | np.isfinite(exact)).sum())
    if not tried:
        return Check("hits", "the camera does not see the mesh", 0.0, None)
    line = f"{other.sum()} of {tried} of the camera's rays meet another surface than in float64, or none"
    return rare("hits", line, other.sum(), tried, OTHER)


def nearest(
    corners: Float[np.ndarray, "F 3 3"], o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]
) -> Float[np.ndarray, "R"]:
    """Distance to the nearest triangle, from either side; infinite for none. Möller and Trumbore (1997), in float64."""
    e, f, found = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], []
    for some in np.array_split(np.arange(len(o)), max(1, -(-len(o) * len(corners) // AT_ONCE))):
        across = np.cross(d[some, None], f)
        volume = np.einsum("fi,rfi->rf", e, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            over = 1 / volume
            from_corner = o[some, None] - corners[:, 0]
            u = np.einsum("rfi,rfi->rf", from_corner, across) * over
            along = np.cross(from_corner, e)
            v = np.einsum("ri,rfi->rf", d[some], along) * over
            t = np.einsum("fi,rfi->rf", f, along) * over
        found.append(np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf).min(axis=1, initial=np.inf))
    return np.concatenate(found)


def _of_network(device_material: DeviceMaterial, rng: np.random.Generator) -> list[Check]:
    """Random queries, half of them at the ends of curvature, a quarter grazing, and an eighth both, of all footprints."""
    u, radius = rng.uniform(size=(POINTS, 2)), 10.0 ** rng.uniform(-5, 1, POINTS)
    toward = rng.normal(size=(2, POINTS, 3))
    toward[0, :, 2] = np.abs(toward[0, :, 2]) * np.where(np.arange(POINTS) % 4, 1, 1e-3)
    w, light = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    kappa = np.where(np.arange(POINTS) // 4 % 2, rng.choice([-1.0, 1.0], POINTS), rng.uniform(-1, 1, POINTS))
    rows = tuple(x.astype(np.float32) for x in (u, radius, w, kappa, light))
    alpha, rho = (np.asarray(x, np.float64) for x in _answers(device_material.config, device_material.table, rows))
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):  # lookups make integers of the default type
        table, fine = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), (device_material.table, rows))
        exact_alpha, exact_rho = (np.asarray(x) for x in _answers(device_material.config, table, fine))
    wrong = ~((alpha >= 0) & (alpha <= 1) & np.isfinite(rho).all(axis=1) & (rho >= 0).all(axis=1))
    line = f"{wrong.sum()} of {POINTS} queries have an opacity out of 0 to 1, or reflect what is negative or not finite"
    light_of, exact = alpha[:, None] * rho, exact_alpha[:, None] * exact_rho
    most = max(exact.max(), np.finfo(np.float64).tiny)
    error = np.max([np.abs(alpha - exact_alpha).max(), np.abs(light_of - exact).max() / most])  # NaN stays
    said = f"float32 changes opacity and reflected light by at most {error:.1g}"
    return [Check("material", line, float(wrong.sum()), 0.0), Check("network", said, float(error), ERROR)]


@partial(jax.jit, static_argnums=0)
def _answers(config: SurfaceConfig, table: BlurredSurface, rows: tuple[Array, ...]) -> tuple[Array, Array]:
    """α (N,) and ρ (N, 3)."""

    def one(u: Array, radius: Array, w: Array, kappa: Array, light: Array) -> tuple[Array, Array]:
        place = SurfaceQuery(u, radius, w, kappa)
        opacity = eval_opacity(config, table, place)
        return opacity.alpha, reflectance(config, table, place, opacity, light)

    return jax.vmap(one)(*rows)
