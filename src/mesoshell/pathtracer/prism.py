"""One prism of the walk through a shell, in float64 (shell/geometry/march, line by line; Dr.Jit in place of JAX).

Notation
o, d        ray origin and unit direction; a walk backward has −d and counts t from o along it     (3,), world
p_k, n_k    base points relative to o, and posts, of a prism's three vertices                      (3,), world
F_k         d · (p_k × n_k): zero where the ray's line meets the line of post k
λ           barycentric coordinates in a prism's triangle, (λ₀, λ₁)
h           relative height, 0 on the base surface and 1 on the top
face code   0, 1, 2: the side from vertex k to k + 1;  3: top;  4: base

Every ray walks in float64: on a CPU a step costs a hundredth of the network evaluations that follow.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

TOP, BASE = 3, 4
#: Exit codes of a walk that has not ended, and of one that is outside every prism.
WALKING, LOST = 5, 6
#: Most steps from the face that float32 met to the one that owns a ray: half way round a vertex.
HOPS = 16
_ROUNDINGS, _EPS = 8.0, 2.0**-52
_WIDEST, _FAR_OFF = 1e-3, 1e-6


@dataclass
class WalkState:
    """State of a walk: prism, distance and its error bound, λ and h where it entered the prism, exit code."""

    prism: mi.UInt32
    t: mi.Float64
    slack: mi.Float64
    bary: mi.Vector2d
    h: mi.Float64
    exit: mi.UInt32


@dataclass
class Piece:
    """A prism's part of a ray: from t0 to t1, with λ and h at both ends."""

    prism: mi.UInt32
    t0: mi.Float64
    t1: mi.Float64
    bary0: mi.Vector2d
    bary1: mi.Vector2d
    h0: mi.Float64
    h1: mi.Float64


class _Crossing:
    """A crossing with a side or a cap, as in geometry/patch; not state of a loop."""

    def __init__(self, t, u, h, inside, margin, slack, bary):
        self.t, self.u, self.h, self.inside = t, u, h, inside
        self.margin, self.slack, self.bary = margin, slack, bary


def corners(prisms, o, prism):
    """Base points relative to o, and posts."""
    rows = [mi.Vector3d(dr.gather(mi.Vector3f, prisms.corners, prism * 6 + k)) for k in range(6)]
    return [row - o for row in rows[:3]], rows[3:]


@dr.syntax
def owner(prisms, o, d, prism, code, active):
    """The prism through whose top or base (by `code`) a ray goes in float64: the one met in float32, or one nearby. active:
    rays that meet such a face."""
    moves, hops = mi.Bool(active), mi.UInt32(0)
    while moves & (hops < HOPS):
        c = cap(prisms, o, prism, code)
        sense = dr.sign(dr.dot(dr.cross(c[1] - c[0], c[2] - c[0]), d))
        outside = [sense * dr.dot(dr.cross(c[k], c[(k + 1) % 3]), d) for k in range(3)]
        least = dr.minimum(dr.minimum(outside[0], outside[1]), outside[2])
        edge = dr.select(outside[0] == least, mi.UInt32(0), dr.select(outside[1] == least, mi.UInt32(1), mi.UInt32(2)))
        beyond = dr.gather(mi.Int32, prisms.across, prism * 3 + edge)
        moves = (least < 0) & (beyond >= 0)
        there = cap(prisms, o, dr.select(moves, mi.UInt32(beyond), prism), code)
        moves &= sense * dr.dot(dr.cross(there[1] - there[0], there[2] - there[0]), d) > 0  # else it faces away
        prism = dr.select(moves, mi.UInt32(beyond), prism)
        hops += 1
    return prism


def cap(prisms, o, prism, code):
    """Corners of a prism's top, or base, relative to o."""
    p, n = corners(prisms, o, prism)
    return [a + dr.select(code == TOP, b, 0) for a, b in zip(p, n, strict=True)]


def enter(prisms, o, d, prism, code):
    """The place where a ray enters `prism` through face `code` (an outer face: top, base, or a side at a border).

    An intersector reports top and base, so they are trusted; at a side, only an exact crossing counts.
    """
    p, n = corners(prisms, o, prism)
    top = leave_cap(d, [a + b for a, b in zip(p, n, strict=True)], -1)
    base = leave_cap(d, p, 1)
    k = dr.minimum(code, 2)
    first, second = dr.select(k == 2, 0, k + 1), k  # the side seen from outside: its leaving is our entering
    p0, p1, n0, n1 = _pick(p, first), _pick(p, second), _pick(n, first), _pick(n, second)
    side = leave_side(d, (p0, p1), (n0, n1), (_post(d, p0, n0), _post(d, p1, n1)))
    is_top, is_base = code == TOP, code == BASE
    t = dr.select(is_top, top.t, dr.select(is_base, base.t, side.t))
    bary = dr.select(is_top, top.bary, dr.select(is_base, base.bary, _along_side(k, side.u, 1 - side.u)))
    h = dr.select(is_top, 1.0, dr.select(is_base, 0.0, side.h))
    met = dr.select(code < TOP, side.inside >= 0, True) & dr.isfinite(t)
    slack = dr.select(is_top, top.slack, dr.select(is_base, base.slack, side.slack))
    return WalkState(
        prism,
        t,
        slack,
        dr.select(met, bary, 0.0),
        dr.clip(h, 0, 1),
        dr.select(met, mi.UInt32(WALKING), mi.UInt32(LOST)),
    )


def step(prisms, o, d, place):
    """Cross one prism: the place after it, and the piece inside it."""
    p, n = corners(prisms, o, place.prism)
    f = [_post(d, p[k], n[k]) for k in range(3)]
    sides = [leave_side(d, (p[i], p[j]), (n[i], n[j]), (f[i], f[j])) for i, j in ((0, 1), (1, 2), (2, 0))]
    caps = [leave_cap(d, [a + b for a, b in zip(p, n, strict=True)], 1), leave_cap(d, p, -1)]
    faces = [*sides, *caps]
    code, lost = _choose(faces, place)
    t1 = dr.select(lost, place.t, dr.maximum(_pick([f.t for f in faces], code), place.t))
    u = dr.clip(_pick([f.u for f in faces], code), 0, 1)
    edge = dr.minimum(code, 2)
    bary1 = dr.select(code == TOP, caps[0].bary, dr.select(code == BASE, caps[1].bary, _along_side(edge, 1 - u, u)))
    h1 = dr.clip(_pick([f.h for f in faces], code), 0, 1)
    piece = Piece(place.prism, place.t, t1, place.bary, bary1, place.h, h1)
    at_side = code < TOP
    beyond = dr.gather(mi.Int32, prisms.across, place.prism * 3 + edge, at_side)
    stays = ~at_side | (beyond < 0)
    other = dr.gather(mi.UInt32, prisms.across_edge, place.prism * 3 + edge, ~stays)
    after = WalkState(
        dr.select(stays, place.prism, mi.UInt32(beyond)),
        t1,
        _pick([f.slack for f in faces], code),
        dr.select(stays, bary1, _along_side(other, u, 1 - u)),
        h1,
        dr.select(lost, mi.UInt32(LOST), dr.select(stays, code, mi.UInt32(WALKING))),
    )
    return after, piece


def _choose(faces, place):
    """Which face the ray leaves through: the nearest one ahead whose bounds it meets, else the one it misses by least; and
    whether even that one is missed by far: the ray is not in here."""
    own = 64 * _EPS * dr.abs(place.t) + place.slack
    nearest, least, code, fallback = mi.Float64(dr.inf), mi.Float64(-dr.inf), mi.UInt32(0), mi.UInt32(0)
    for k, face in enumerate(faces):
        finite = dr.isfinite(face.t)
        slack = own + dr.select(finite, face.slack, 0)
        ahead = finite & (face.t >= place.t - slack) & (face.inside > -dr.inf)
        meets = ahead & (face.inside >= -dr.minimum(face.margin, _WIDEST))
        closer = meets & (face.t < nearest)
        nearest, code = dr.select(closer, face.t, nearest), dr.select(closer, mi.UInt32(k), code)
        better = ahead & (face.inside > least)
        least, fallback = dr.select(better, face.inside, least), dr.select(better, mi.UInt32(k), fallback)
    none = nearest == dr.inf
    return dr.select(none, fallback, code), none & (least < -_FAR_OFF)


def leave_side(d, p, n, f):
    """Where the ray leaves through the side between two posts, given F at both (Reshetov 2019)."""
    e, m = p[1] - p[0], n[1] - n[0]
    a = dr.dot(d, dr.cross(e, m))
    c = f[0]
    b = f[1] - f[0] - a
    far, long = dr.maximum(dr.norm(p[0]), dr.norm(p[1])), dr.maximum(dr.norm(n[0]), dr.norm(n[1]))
    error = _ROUNDINGS * _EPS * far * long
    discriminant = b * b - 4 * a * c
    root = dr.sqrt(dr.maximum(discriminant, 0))
    q = -(b + dr.select(b > 0, root, -root)) / 2
    u = dr.select(b > 0, _divide(c, q), _divide(q, a))
    through = (f[0] < 0) & (f[1] >= 0)
    u = dr.select(through, dr.clip(u, 0, 1), u)
    backward = (f[0] > error) & (f[1] < -error)
    exists = through | ((discriminant > 0) & ~backward & dr.isfinite(u))
    u = dr.select(exists, u, 0.5)
    q_u, n_u = p[0] + u * e, n[0] + u * m
    dxn = dr.cross(d, n_u)
    area = dr.dot(dxn, dxn)
    t = _divide(dr.dot(dr.cross(q_u, n_u), dxn), area)
    h = _divide(dr.dot(dr.cross(q_u, d), dxn), area)
    sine = dr.maximum(dr.sqrt(area), 1e-300)
    margin_u = dr.select(exists, error / dr.maximum(root, error), 0)
    margin_h = (_ROUNDINGS * _EPS * far + margin_u * (dr.norm(e) + dr.abs(h) * dr.norm(m))) / sine
    across = dr.select(through, dr.inf, dr.minimum(u, 1 - u))
    inside = dr.select(exists, dr.minimum(across, dr.minimum(h, 1 - h)), -dr.inf)
    return _Crossing(t, u, h, inside, dr.maximum(margin_u, margin_h), margin_h * dr.norm(n_u), None)


def leave_cap(d, c, outward):
    """Where the ray leaves through a triangle, counter-clockwise from above; outward is 1 for the top, −1 for the base."""
    w = [dr.dot(dr.cross(c[(k + 1) % 3], c[(k + 2) % 3]), d) for k in range(3)]
    normal = dr.cross(c[1] - c[0], c[2] - c[0])
    total = dr.dot(normal, d)
    leaves = total > 0 if outward > 0 else total < 0
    size = dr.maximum(dr.maximum(dr.norm(c[0]), dr.norm(c[1])), dr.norm(c[2]))
    error = _ROUNDINGS * _EPS * size * size
    weights = [_divide(x, total) for x in w]
    t = _divide(dr.dot(normal, c[0]), total)
    inside = dr.select(leaves, dr.minimum(dr.minimum(weights[0], weights[1]), weights[2]), -dr.inf)
    margin = error / dr.maximum(dr.abs(total), error)
    slack = _ROUNDINGS * _EPS * size + margin * dr.norm(normal) / size
    h = mi.Float64(1.0 if outward > 0 else 0.0)
    return _Crossing(t, mi.Float64(0), h, inside, margin, slack, mi.Vector2d(weights[0], weights[1]))


def _post(d, p, n):
    return dr.dot(d, dr.cross(p, n))


def _divide(a, b):
    return dr.select(b == 0, dr.inf, a / dr.select(b == 0, 1, b))


def _pick(x, i):
    value = x[0]
    for k in range(1, len(x)):
        value = dr.select(i == k, x[k], value)
    return value


def _along_side(edge, first, second):
    """λ with `first` at vertex `edge` and `second` at the next."""
    x = dr.select(edge == 0, first, dr.select(edge == 2, second, 0))
    y = dr.select(edge == 1, first, dr.select(edge == 0, second, 0))
    return mi.Vector2d(x, y)
