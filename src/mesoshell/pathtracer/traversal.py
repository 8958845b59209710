"""A ray's way through all shells, one prism at a time (shell/geometry/tracer, as a state machine a lane).

Notation
o, d        ray origin and unit direction, float64                                (3,), world
t           distance from o                                                       world
tmax        where the ray meets a surface of the scene                            world
start       where the rest of the ray begins: before it lies nothing, or was walked   world

A ray in free space is intersected with the boundary. It enters a shell through the top from outside, through the base from
behind, or through a border's side; it leaves through them the other way. (A border is met as the tetrahedron around its
bilinear side: the exact side decides.)

A ray that is known to begin outside is walked from each of its entries, in their order: after a walk the next boundary is
sought from its entry on, since shells may overlap. An exit that no walk has reached has an entry at an edge hidden by
rounding: walk back to there, or to where the last walk ended, then forward. (The ray's own beginning is not such an end: that
it begins outside is believed.)

A ray that may begin inside a shell: if its first boundary is an exit, it began inside; walk back to its origin, then forward.
If its first boundary is an entry, count entries and exits along the rest of the ray; more exits mean that it began inside
another shell. Then search the exits for the one whose backward walk reaches the origin. After a walk it may be inside another
shell again.

Where two visits overlap, the later one begins where the earlier one ended. So density is never counted twice, and pieces come
in the order of the ray.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.prism import LOST, TOP, WALKING, Piece, WalkState, enter, owner, step

FREE, COUNT, SEARCH, BACK, FORWARD, OVER = 0, 1, 2, 3, 4, 5
#: Step past a boundary before free space begins again, relative to the shells' size and the distance from their centre, or from
#: the ray's origin if that is nearer.
ADVANCE = 2e-6
#: Shells are no further than this from where a ray begins: one that seems so has no origin or no direction.
FARTHEST = 1e18
#: Prisms that a ray crosses without progress before it is lost and free space begins again: a ray along a post goes round it
#: through every prism there, and one along a side to and fro.
MAX_STUCK = 64
#: Steps after which the length of a ray in shells is given up.
MAX_MOVES = 10_000


@dataclass
class Walker:
    """State of a ray. sure: it began outside, and has been walked from all its entries before `at`, where the next boundary
    query begins; walked: a walk ended at `start`; depth: how often it has entered since `start`; stuck: how many prisms it has
    crossed without progress."""

    mode: mi.UInt32
    start: mi.Float64
    sure: mi.Bool
    walked: mi.Bool
    at: mi.Float64
    depth: mi.UInt32
    place: WalkState
    stuck: mi.UInt32


def nowhere() -> WalkState:
    """A walk that is in no prism."""
    return WalkState(mi.UInt32(0), mi.Float64(0), mi.Float64(0), mi.Vector2d(0), mi.Float64(0), mi.UInt32(LOST))


def no_piece() -> Piece:
    """An interval of no prism."""
    zero, none = mi.Float64(0), mi.Vector2d(0)
    return Piece(mi.UInt32(0), zero, mi.Float64(0), none, mi.Vector2d(0), mi.Float64(0), mi.Float64(0))


def at_start(start, outside) -> Walker:
    """A ray at its start; outside: it is known to begin outside all shells."""
    none = dr.zeros(mi.UInt32, dr.width(start))
    start, never = mi.Float64(start), dr.full(mi.Bool, False, dr.width(start))
    return Walker(none + FREE, start, mi.Bool(outside), never, mi.Float64(start), none + 0, nowhere(), none + 0)


@dr.syntax
def advance(shells, o, d, tmax, w):
    """One step: query the boundary, or cross one prism. Returns the walker, a piece, and whether there is one."""
    piece, some = no_piece(), mi.Bool(False)
    if w.mode <= SEARCH:
        w = _ask(shells, o, d, tmax, w)
    elif w.mode != OVER:
        w, piece, some = _cross(shells, o, d, tmax, w)
    return w, piece, some


@dr.syntax
def length(shells, o, d, tmax):
    """Of rays that begin outside, how far they are in shells before tmax; NaN for one that takes MAX_MOVES."""
    w = at_start(dr.zeros(mi.Float64, dr.width(o)), dr.full(mi.Bool, True, dr.width(o)))
    total, moves = dr.zeros(mi.Float64, dr.width(o)), dr.zeros(mi.UInt32, dr.width(o))
    while (w.mode != OVER) & (moves < MAX_MOVES):
        w, piece, some = advance(shells, o, d, tmax, w)
        total += dr.select(some, piece.t1 - piece.t0, 0.0)
        moves += 1
    return dr.select(w.mode == OVER, total, dr.nan)


def _ask(shells, o, d, tmax, w: Walker) -> Walker:
    """Query the boundary from free space."""
    clear = dr.dot(shells.centre - o, d) - shells.size  # no shell lies before: its box is as wide at most
    at = dr.select((clear > w.at) & (clear < FARTHEST), clear, w.at)
    x = o + at * d
    met = shells.scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(x - shells.centre), mi.Vector3f(d)))
    hit = met.is_valid()
    triangle = dr.select(hit, met.prim_index, 0)
    normal = dr.gather(mi.Vector3d, shells.normal, triangle)
    slope = dr.dot(normal, d)
    exact = dr.dot(normal, dr.gather(mi.Vector3d, shells.point, triangle) - x) / dr.select(slope == 0, 1, slope)
    rough = mi.Float64(met.t)
    close = (slope != 0) & (dr.abs(exact - rough) < 1e-3 * (shells.size + rough))
    t = at + dr.maximum(dr.select(close, exact, rough), 0)
    code, prism = dr.gather(mi.UInt32, shells.code, triangle), dr.gather(mi.UInt32, shells.prism, triangle)
    border, against = code < TOP, slope < 0
    prism = owner(shells, o, d, prism, code, hit & ~border)
    ahead, behind = enter(shells, o, d, prism, code), enter(shells, o, -d, prism, code)
    cap_in = dr.select(code == TOP, against, ~against)
    enters = hit & (ahead.exit == WALKING) & dr.select(border, ahead.t > w.at, cap_in)
    leaves = hit & (behind.exit == WALKING) & dr.select(border, -behind.t > w.at, ~cap_in)
    out = leaves & (~enters | (-behind.t < ahead.t))  # of a border's two crossings the nearer one
    into = enters & ~out
    free, counting, searching = w.mode == FREE, w.mode == COUNT, w.mode == SEARCH
    known = w.sure & (-behind.t <= _past(shells, o, d, w.start))
    back = out & ((free & ~known) | searching)
    forward = into & free & w.sure
    count = (into & free & ~w.sure) | (counting & hit & ~(out & (w.depth == 0)))
    search = (counting & out & (w.depth == 0)) | (searching & hit & ~back)
    settled = (counting | searching) & ~hit
    mode = dr.select(count, mi.UInt32(COUNT), dr.select(search, mi.UInt32(SEARCH), mi.UInt32(FREE)))
    mode = dr.select(back, mi.UInt32(BACK), dr.select(forward, mi.UInt32(FORWARD), mode))
    mode = dr.select((free & ~hit) | (forward & (ahead.t >= tmax)), mi.UInt32(OVER), mode)
    event = dr.maximum(t, dr.select(into, ahead.t, dr.select(out, -behind.t, t)))
    event = dr.select(settled | (counting & search), w.start, event)
    on = _past(shells, o, d, event)
    start = dr.select((mode == FREE) & ~settled & ~w.sure, on, w.start)  # the boundary met there does not count
    depth = dr.select(into, w.depth + 1, dr.select(out & (w.depth > 0), w.depth - 1, w.depth))
    depth, place = dr.select(count, depth, 0), dr.select(back, behind, ahead)
    return Walker(mode, start, w.sure | settled, w.walked, on, depth, place, mi.UInt32(0))


def _cross(shells, o, d, tmax, w: Walker):
    """Cross one prism, forward or back."""
    back = w.mode == BACK
    after, piece = step(shells, o, dr.select(back, -d, d), w.place)
    stuck = dr.select(after.t > w.place.t, 0, w.stuck + 1)
    after.exit = dr.select(stuck < MAX_STUCK, after.exit, LOST)
    # back: the prism's far end is where the ray enters it
    there, ended, lost = -after.t <= w.start, after.exit != WALKING, after.exit == LOST
    reached = back & ~lost & dr.select(there, w.walked | ~w.sure, w.sure & ended)
    nothing = back & w.sure & ~reached & (ended | there)
    entry = WalkState(piece.prism, -piece.t1, after.slack, piece.bary1, piece.h1, mi.UInt32(WALKING))
    left = ~back & (after.exit != WALKING)
    over = ~back & (after.t >= tmax)
    elsewhere = back & ~w.sure & ~reached & ended
    beyond = dr.select((after.exit != LOST) & (after.t > w.start), after.t, w.at)  # without progress, past the boundary
    end = dr.select(w.sure, dr.maximum(after.t, w.start), beyond)
    mode = dr.select(reached, mi.UInt32(FORWARD), dr.select(elsewhere, mi.UInt32(SEARCH), w.mode))
    mode = dr.select(over, mi.UInt32(OVER), dr.select(left | nothing, mi.UInt32(FREE), mode))
    some, piece = _cut(piece, w.start, tmax)
    place = dr.select(reached, entry, after)
    start = dr.select(left, end, w.start)
    at = dr.select(left & ~w.sure, dr.maximum(_past(shells, o, d, end), w.at), w.at)
    return Walker(mode, start, w.sure, w.walked | left, at, w.depth, place, stuck), piece, some & ~back


def _past(shells, o, d, t):
    """Where free space begins again after a boundary at t: Embree's rounding grows with the distance from shells.centre."""
    away = dr.norm(o + t * d - shells.centre)
    return t + ADVANCE * (shells.size + dr.select(away < t, away, t))


def _cut(i: Piece, begin, end):
    """The part of a piece between begin and end, λ and h interpolated there; and whether there is one."""
    t0, t1 = dr.maximum(i.t0, begin), dr.minimum(i.t1, end)
    some = t1 > t0
    length = dr.select(some, i.t1 - i.t0, 1)
    a, b = (t0 - i.t0) / length, (t1 - i.t0) / length
    bary0, bary1 = (1 - a) * i.bary0 + a * i.bary1, (1 - b) * i.bary0 + b * i.bary1
    return some, Piece(i.prism, t0, t1, bary0, bary1, (1 - a) * i.h0 + a * i.h1, (1 - b) * i.h0 + b * i.h1)
