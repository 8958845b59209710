"""Rays against the shell: entry through Embree, then the prism walk, then on to the next entry.

Notation
o, d        ray origin and unit direction, float64 on the host                       (R, 3), world
t           distance from the origin                                                 world
code        0, 1, 2: a side at a border; 3: the top; 4: the base surface

Embree sees three kinds of triangles: the top, the base surface, and around each side at a border the four faces of the
tetrahedron over its corners, which encloses the bilinear side whatever its twist. A ray in free space meets one of:

    the top from outside       it enters: walk forward
    the top from inside        it began inside (a camera in the shell, or where two parts overlap): walk backward from there
    the base from outside      it ends there; if a prism stands on that face it came through it: walk backward
    the base from behind       it ends there
    a border's tetrahedron     the exact side decides: it enters, or it leaves (walk backward), or it goes on

A walk that leaves through top or border returns the ray to free space, where Embree is queried again; so any number of
visits is found. A walk may pass something else (an object in the shell, the shell of another part): then Embree is queried
from the walk's beginning, and what lies behind a surface is cut off. Where visits overlap, the later one begins where the
earlier one ended: density is not counted twice.

Rays are traced from right before the scene, however far their origin is: Embree's rounding, and the step past a surface, grow
with distance. Embree sees float32, the walk float64 where it must: a ray near an edge of the top first moves to the triangle
that owns it in float64. A surface underneath that lets rays pass (`opaque` false) is for rays that begin outside the shell.
"""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int

from mesoshell.shell.geometry.batched_walk import Intervals, Starts, Visits, on_host, visit
from mesoshell.shell.geometry.extrude import TETRAHEDRON, Shell
from mesoshell.shell.geometry.intervals import cut, without_overlap
from mesoshell.shell.geometry.march import BASE, LOST, TOP, as_tables

#: Step past a surface before free space begins again, relative to the scene's size.
ADVANCE = 2e-6
#: Rays begin at most so many radii of all that they may meet before its middle: what rounding costs grows with distance.
CLEAR = 1.1
#: Origins beyond this count as infinite: the square of their distance overflows float32.
REACH = 1e18
#: A ray passes at most so many radii of the scene beside the point that Embree reports: bounds what float32 rounds.
BESIDE = 128 * float(np.finfo(np.float32).eps)
#: Steps from the triangle that Embree reports to the one that owns the ray: at most half way round a vertex.
HOPS = 16


class Trace(NamedTuple):
    """What rays meet. Intervals are sorted by ray, then along it, and do not overlap.

    end: distance at which each ray ends on the base surface, infinite for none; face: that mesh face, −1 for none; bary:
    where on it. walked: visits computed; redone: how many of them in float64.
    """

    intervals: Intervals
    end: Float[np.ndarray, "R"]
    face: Int[np.ndarray, "R"]
    bary: Float[np.ndarray, "R 2"]
    walked: int
    redone: int


class Boundary:
    """A shell ready to be traced.

    base_faces: faces of the surface underneath, also those that carry no prism. others: triangles of further objects; they
    are numbered after base_faces. opaque: whether the surface underneath stops rays (in a training slab it does not).
    """

    def __init__(
        self,
        shell: Shell,
        base_faces: Int[np.ndarray, "F 3"],
        others: Float[np.ndarray, "N 3 3"] | None = None,
        opaque: bool = True,
    ):
        tables = as_tables(shell.base, shell.offset, shell.faces, shell.neighbour, shell.neighbour_edge)
        self.prisms = on_host(tables)
        self.mesh_face = shell.mesh_face
        self.neighbour = shell.neighbour
        self.opaque = opaque
        count = len(shell.faces)
        foot = shell.base.astype(np.float64)  # float32 would round the top to the grid of a scene far from the origin
        top = foot + shell.offset
        parts = [(top[shell.faces], np.arange(count), np.full(count, TOP), shell.mesh_face)]
        if opaque:
            prism_on_face = np.full(len(base_faces), -1)
            prism_on_face[shell.mesh_face] = np.arange(count)
            here = np.arange(len(base_faces))
            parts.append((foot[base_faces], prism_on_face, np.full(len(base_faces), BASE), here))
        if others is not None and len(others):
            none, here = np.full(len(others), -1), len(base_faces) + np.arange(len(others))
            parts.append((others, none, np.full(len(others), BASE), here))
        p, k = np.nonzero(shell.neighbour < 0)
        if len(p):
            ends = np.stack([shell.faces[p, k], shell.faces[p, (k + 1) % 3]], axis=1)
            corners = np.concatenate([foot[ends], top[ends][:, ::-1]], axis=1)
            p, k = np.repeat(p, 4), np.repeat(k, 4)
            parts.append((corners[:, TETRAHEDRON].reshape(-1, 3, 3), p, k, shell.mesh_face[p]))
        self.corners, self.prism, self.code, self.face = (
            np.concatenate(x).astype(np.float64 if i == 0 else np.int32) for i, x in enumerate(zip(*parts, strict=True))
        )
        edges = np.roll(self.corners, -1, axis=1) - self.corners
        self.normal = np.cross(edges[:, 0], -edges[:, 2])
        self.longest = np.linalg.norm(edges, axis=-1).max(axis=1)
        self.size = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        self.centre = self.corners.mean(axis=(0, 1))  # Embree works in float32: keep its numbers small
        self.radius = float(np.linalg.norm(self.corners - self.centre, axis=-1).max())
        self.scene = EmbreeScene(robust=True)
        TriangleMesh(self.scene, np.ascontiguousarray(self.corners - self.centre, np.float32))
        self.solid, self.of_solid = None, np.flatnonzero(self.code == BASE)
        if len(self.of_solid):
            self.solid = EmbreeScene(robust=True)
            TriangleMesh(self.solid, np.ascontiguousarray((self.corners - self.centre)[self.of_solid], np.float32))

    def first_hit(self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Triangle met first (−1: none), and its distance refined in float64 on the triangle's plane."""
        hits = self.scene.run((o - self.centre).astype(np.float32), d.astype(np.float32), output=True)
        triangle = np.where(hits["geomID"] < 0, -1, hits["primID"])
        met = np.flatnonzero(triangle >= 0)
        u, v, at = hits["u"][met], hits["v"][met], triangle[met]
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        sure = inside * np.abs(_dot(self.normal[at], d[met])) > BESIDE * self.radius * self.longest[at]
        triangle = self._owner(triangle, met[~sure], o, d)
        rough = hits["tfar"].astype(np.float64)
        normal = self.normal[triangle]
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = _dot(normal, self.corners[triangle, 0] - o) / _dot(normal, d)
        close = np.abs(exact - rough) < 1e-3 * (self.size + rough)
        return triangle, np.where(triangle < 0, np.inf, np.where(close, exact, rough))

    def _owner(self, triangle: np.ndarray, rays: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Each ray's triangle. Of `rays` on the top the one that they meet in float64: the reported one, or one nearby."""
        triangle = triangle.copy()
        rays = rays[self.code[triangle[rays]] == TOP]
        for _ in range(HOPS):
            if not len(rays):
                break
            at = triangle[rays]
            c = self.corners[at] - o[rays, None]
            side = np.where(_dot(self.normal[at], d[rays]) < 0, -1.0, 1.0)
            across = np.einsum("rki,ri->rk", np.cross(c, np.roll(c, -1, axis=1)), d[rays]) * side[:, None]
            edge = across.argmin(axis=1)
            beyond = self.neighbour[at, edge]
            turned = _dot(self.normal[beyond], d[rays]) * side < 0
            moves = (across.min(axis=1) < 0) & (beyond >= 0) & ~turned
            triangle[rays[moves]] = beyond[moves]
            rays = rays[moves]
        return triangle

    def occluded(self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]) -> Bool[np.ndarray, "R"]:
        """Whether a surface (not the shell) blocks a ray."""
        if self.solid is None or not len(o):
            return np.zeros(len(o), bool)
        return self.solid.run((o - self.centre).astype(np.float32), d.astype(np.float32), query="OCCLUDED") >= 0

    def solid_within(
        self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"], most: Float[np.ndarray, "R"]
    ) -> np.ndarray:
        """The triangle of a surface (not the shell) that each ray meets first, no further than `most` (−1: none)."""
        if self.solid is None or not len(o):
            return np.full(len(o), -1)
        hits = self.solid.run(
            (o - self.centre).astype(np.float32), d.astype(np.float32), dists=most.astype(np.float32), output=True
        )
        return np.where(hits["geomID"] < 0, -1, self.of_solid[np.maximum(hits["primID"], 0)])

    def trace(self, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"], exact: bool = False) -> Trace:
        """Every interval of every ray. A ray that is not finite, or has no direction, misses. exact: all in float64."""
        o, d = np.asarray(o, np.float64), np.asarray(d, np.float64)
        length = np.linalg.norm(np.nan_to_num(d, posinf=0, neginf=0), axis=1)
        reachable = (np.abs(o) < REACH).all(axis=1)  # false for NaN
        usable = reachable & np.isfinite(d).all(axis=1) & (np.abs(length - 1) < 1e-3)
        alive = np.flatnonzero(usable)
        skipped = np.zeros(len(o))
        nearest = _dot(self.centre - o[alive], d[alive]) / length[alive] ** 2  # d is a unit vector to 1e-3
        skipped[alive] = np.maximum(nearest - CLEAR * self.radius / length[alive], 0)
        begin = o.copy()
        begin[alive] += skipped[alive, None] * d[alive]
        state = _State(self, begin, d, exact)
        while len(alive):
            alive = state.advance(alive)
        i = without_overlap([cut(part, part.t0, state.end[part.ray]) for part in state.parts])
        i = i._replace(t0=i.t0 + skipped[i.ray], t1=i.t1 + skipped[i.ray])
        return Trace(i, state.end + skipped, state.face, state.bary, state.walked, state.redone)


class _State:
    """One `trace` under way: how far each ray has come, where it ended, and its intervals so far."""

    def __init__(self, boundary: Boundary, o: np.ndarray, d: np.ndarray, exact: bool):
        self.boundary, self.o, self.d, self.exact = boundary, o, d, exact
        count = len(o)
        self.start = np.zeros(count)
        self.end = np.full(count, np.inf)
        self.face = np.full(count, -1, np.int32)
        self.bary = np.zeros((count, 2), np.float32)
        self.parts: list[Intervals] = []
        self.walked = self.redone = 0

    def advance(self, rays: np.ndarray) -> np.ndarray:
        """Query Embree once for rays in free space, walk those that enter, and return the rays that are in free space again."""
        b = self.boundary
        triangle, t = b.first_hit(self.o[rays] + self.start[rays, None] * self.d[rays], self.d[rays])
        rays, triangle = rays[triangle >= 0], triangle[triangle >= 0]
        t = np.maximum(t[np.isfinite(t)], 0) + self.start[rays]
        code, prism = b.code[triangle], b.prism[triangle]
        outside = _dot(b.normal[triangle], self.d[rays]) < 0
        on_base, border = code == BASE, code < TOP
        self._end(rays[on_base], b.face[triangle[on_base]], t[on_base], self._where(triangle, rays, t)[on_base])
        forward = ((code == TOP) & outside) | border
        visits = self._visit(rays[forward], prism[forward], code[forward], t[forward], 1.0)
        missed = np.zeros(len(rays), bool)
        missed[forward] = visits.left == LOST
        backward = ((code == TOP) & ~outside) | (on_base & outside & (prism >= 0)) | (border & missed)
        self._visit(rays[backward], prism[backward], code[backward], t[backward], -1.0)
        reached = t.copy()
        entered = forward & ~missed
        reached[entered] += visits.t[visits.left != LOST]
        down = np.zeros(len(rays), bool)
        down[forward] = visits.left == BASE
        at = visits.left == BASE
        if b.opaque:
            self._end(rays[down], b.mesh_face[visits.prism[at]], reached[down], visits.bary[at])
        step = ADVANCE * (b.size + reached)
        aside = border.copy()
        aside[forward] |= (visits.left >= 0) & (visits.left < TOP)
        stopped = self._stopped(rays, aside, reached, step)
        passed = self._passed(rays, t + step, reached - step, entered)
        self.start[rays] = np.where(passed, t, reached) + step
        return rays[passed | ~(on_base | stopped | (down & b.opaque))]

    def _stopped(self, rays: np.ndarray, aside: np.ndarray, reached: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Whether a surface begins within a step of where a ray leaves, having met a border (aside): a step on is past it."""
        rays, at, step, stopped = rays[aside], reached[aside], step[aside], aside.copy()
        begin = np.maximum(at - step, self.start[rays])
        triangle = self.boundary.solid_within(self.o[rays] + begin[:, None] * self.d[rays], self.d[rays], 2 * step)
        stopped[aside] = met = triangle >= 0
        self._end(rays[met], self.boundary.face[triangle[met]], at[met], self._where(triangle[met], rays[met], at[met]))
        return stopped

    def _passed(self, rays: np.ndarray, begin: np.ndarray, end: np.ndarray, entered: np.ndarray) -> np.ndarray:
        """Whether a walk from `begin` to `end` passed something else: an object in the shell, another part's shell."""
        passed = entered & (begin < end)
        d = self.d[rays[passed]]
        _, t = self.boundary.first_hit(self.o[rays[passed]] + begin[passed, None] * d, d)
        passed[passed] = begin[passed] + t < end[passed]
        return passed

    def _visit(self, rays: np.ndarray, prism: np.ndarray, code: np.ndarray, t: np.ndarray, sense: float) -> Visits:
        """Walk along d (sense 1) or against it (−1) from distance t. Keeps the intervals ahead of `start`, or of the origin."""
        d = self.d[rays] * sense
        starts = Starts(self.o[rays] + t[:, None] * self.d[rays], d, prism, code)
        visits, redone = visit(self.boundary.prisms, starts, self.exact)
        self.walked += len(rays)
        self.redone += redone
        i = visits.intervals
        t0, t1 = t[i.ray] + sense * i.t0, t[i.ray] + sense * i.t1
        intervals = Intervals(rays[i.ray], i.prism, t0, t1, *i[4:])
        if sense < 0:
            # reversed, so that runs grow along the ray
            reversed_ = (rays[i.ray], i.prism, t1, t0, i.bary1, i.bary0, i.h1, i.h0)
            intervals = Intervals(*(x[::-1] for x in reversed_))
        self.parts.append(cut(intervals, self.start[intervals.ray] if sense > 0 else np.zeros(len(intervals.ray))))
        behind = (visits.t + t < self.start[rays]) & (sense > 0)  # a border's side crossed before this ray began
        return visits._replace(left=np.where(behind, LOST, visits.left))

    def _end(self, rays: np.ndarray, face: np.ndarray, t: np.ndarray, bary: np.ndarray) -> None:
        nearer = t < self.end[rays]
        rays = rays[nearer]
        self.face[rays], self.end[rays], self.bary[rays] = face[nearer], t[nearer], bary[nearer]

    def _where(self, triangle: np.ndarray, rays: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Barycentric coordinates (λ₀, λ₁) of the points met."""
        x = self.o[rays] + t[:, None] * self.d[rays]
        a, b, c = self.boundary.corners[triangle].transpose(1, 0, 2)
        n = self.boundary.normal[triangle]
        area = np.maximum(_dot(n, n), np.finfo(np.float64).tiny)
        return np.stack([_dot(np.cross(b - x, c - x), n) / area, _dot(np.cross(c - x, a - x), n) / area], axis=1)


def _dot(a: Float[np.ndarray, "R 3"], b: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
    return np.einsum("ij,ij->i", a, b)
