"""Rays, their pieces in canonical space, and samples of the material there (shell/geometry/sampling, texture/footprint).

Notation
J⁻¹         inverse of ∂P/∂(u, v, h) in the middle of a piece; E: (u, v) = uv₂ + E (λ₀, λ₁)
ℓ           canonical length of a piece, |ξ1 − ξ0|
f           position of a sample on its piece, 0 to 1
λ, h        barycentric coordinates and height; "exact" ones invert the prism's map by Newton's method
ṙ, a        a cone's radius at t is ṙ (t + a)
Σ           σ_t² ddᵀ + σ_r² (1 − ddᵀ), the cone's piece as a Gaussian; J⁻¹ Σ J⁻ᵀ in canonical space
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from mesoshell.pathtracer.prism import Piece


@dataclass
class Ray:
    """A ray from start to tmax, with a cone of radius spread · (t + apex). outside: known to begin outside all shells."""

    o: mi.Vector3d
    d: mi.Vector3d
    start: mi.Float64
    tmax: mi.Float64
    outside: mi.Bool
    spread: mi.Float
    apex: mi.Float


@dataclass
class IntervalFrame:
    """A piece in canonical space: prism, t and ξ at both ends, ℓ, rows of J⁻¹; λ at both ends, where coordinates are exact."""

    prism: mi.UInt32
    t0: mi.Float
    t1: mi.Float
    xi0: mi.Vector3f
    xi1: mi.Vector3f
    length: mi.Float
    a: mi.Vector3f
    b: mi.Vector3f
    c: mi.Vector3f
    bary0: mi.Vector2f
    bary1: mi.Vector2f


@dataclass
class Sample:
    """Where the material is evaluated: prism, distance, ξ, r, and σ_h; the long side of the footprint and its axis, if there
    are taps along it."""

    prism: mi.UInt32
    t: mi.Float
    xi: mi.Vector3f
    radius: mi.Float
    deviation: mi.Float
    major: mi.Float
    axis: mi.Vector2f


def nothing() -> Sample:
    """A sample of nothing: of no weight."""
    z = mi.Float(0)
    return Sample(mi.UInt32(0), z, mi.Vector3f(0), mi.Float(0), mi.Float(0), mi.Float(0), mi.Vector2f(0))


def no_frame() -> IntervalFrame:
    """The frame of no interval."""
    z = mi.Float(0)
    v = mi.Vector3f
    return IntervalFrame(
        mi.UInt32(0), z, mi.Float(0), v(0), v(0), mi.Float(0), v(0), v(0), v(0), mi.Vector2f(0), mi.Vector2f(0)
    )


def canonical_frame(shells, piece: Piece, exact: bool = False) -> IntervalFrame:
    """A piece's ends in canonical space, and J⁻¹ in its middle."""
    base, post, uv = shells.frame(piece.prism)
    bary0, bary1 = mi.Vector2f(piece.bary0), mi.Vector2f(piece.bary1)
    h0, h1 = mi.Float(piece.h0), mi.Float(piece.h1)
    xi0, xi1 = _xi(uv, bary0, h0), _xi(uv, bary1, h1)
    bary, h = 0.5 * (bary0 + bary1), 0.5 * (h0 + h1)
    # far from the origin, h times a post is lost in rounding when added to a base
    x, y = (base[k] - base[2] + h * (post[k] - post[2]) for k in (0, 1))
    z = bary.x * post[0] + bary.y * post[1] + (1 - bary.x - bary.y) * post[2]
    rows = dr.cross(y, z), dr.cross(z, x), dr.cross(x, y)
    volume = dr.dot(x, rows[0])
    inverse = dr.select(volume == 0, 0, 1 / dr.select(volume == 0, 1, volume))
    e0, e1 = uv[0] - uv[2], uv[1] - uv[2]
    a, b = (inverse * (e0[i] * rows[0] + e1[i] * rows[1]) for i in (0, 1))
    t0, t1 = mi.Float(piece.t0), mi.Float(piece.t1)
    ends = (bary0, bary1) if exact else (mi.Vector2f(0), mi.Vector2f(0))
    return IntervalFrame(piece.prism, t0, t1, xi0, xi1, mi.Float(dr.norm(xi1 - xi0)), a, b, inverse * rows[2], *ends)


def _xi(uv, bary, h):
    p = uv[2] + bary.x * (uv[0] - uv[2]) + bary.y * (uv[1] - uv[2])
    return mi.Vector3f(p.x, p.y, h)


def _exact(shells, ray, frame: IntervalFrame, f, t):
    """ξ of the point at t, by four Newton steps on P(λ, h) = x."""
    base, post, uv = shells.frame(frame.prism)
    bary, h = frame.bary0 + f * (frame.bary1 - frame.bary0), frame.xi0.z + f * (frame.xi1.z - frame.xi0.z)
    # relative to a corner: far from the origin float32 has no digits for it
    x = mi.Vector3f(ray.o + mi.Float64(t) * ray.d - mi.Vector3d(base[2]))
    for _ in range(4):
        p, q = (base[k] - base[2] + h * (post[k] - post[2]) for k in (0, 1))
        up = bary.x * post[0] + bary.y * post[1] + (1 - bary.x - bary.y) * post[2]
        off = x - (h * post[2] + bary.x * p + bary.y * q)
        rows = dr.cross(q, up), dr.cross(up, p), dr.cross(p, q)
        volume = dr.dot(p, rows[0])
        scale = dr.select(volume == 0, 0, 1 / dr.select(volume == 0, 1, volume))
        bary += scale * mi.Vector2f(dr.dot(rows[0], off), dr.dot(rows[1], off))
        h += scale * dr.dot(rows[2], off)
    return _xi(uv, bary, h)


def sample_at(context, ray, frame: IntervalFrame, f, share) -> Sample:
    """The sample at position f; share: its part of the piece."""
    f, half = dr.clip(f, 0, 1), dr.minimum(share, 1) * (frame.t1 - frame.t0) / 2
    t = frame.t0 + f * (frame.t1 - frame.t0)
    xi = _exact(context.shells, ray, frame, f, t) if context.exact else frame.xi0 + f * (frame.xi1 - frame.xi0)
    if not context.taps:
        return Sample(frame.prism, t, xi, mi.Float(0), mi.Float(0), mi.Float(0), mi.Vector2f(0))
    spread = context.quality.footprint * ray.spread
    along, across = _cone(dr.maximum(t - half, 0) + ray.apex, t + half + ray.apex, spread)
    radius, deviation, major, axis = footprint(frame, mi.Vector3f(ray.d), along, across)
    deviation *= context.quality.height_filter
    if context.taps == 1:
        major, axis = mi.Float(0), mi.Vector2f(0)
    return Sample(frame.prism, t, xi, radius, deviation, major, axis)


def _cone(t0, t1, radius):
    """Variances along and across a frustum (render/cone)."""
    mu, delta = (t0 + t1) / 2, (t1 - t0) / 2
    squares = 3 * mu * mu + delta * delta
    share = dr.select(squares > 0, delta * delta / dr.select(squares > 0, squares, 1), 0)
    along = delta * delta / 3 - 4 / 15 * share * share * (12 * mu * mu - delta * delta)
    across = radius * radius * (mu * mu / 4 + 5 / 12 * delta * delta - 4 / 15 * delta * delta * share)
    return dr.maximum(along, 0), dr.maximum(across, 0)


def footprint(frame: IntervalFrame, d, along, across):
    """r, the smaller deviation on the tangent plane, the deviation along the height, the larger one on the plane and its axis
    (texture/footprint)."""
    e = canonical(frame, d)
    more = along - across
    p, q = (across * dr.dot(row, row) + more * x * x for row, x in ((frame.a, e.x), (frame.b, e.y)))
    s = across * dr.dot(frame.a, frame.b) + more * e.x * e.y
    half = (p - q) / 2
    root = dr.sqrt(dr.square(half) + s * s)
    largest = dr.maximum((p + q) / 2 + root, 0)
    smallest = dr.select(largest > 0, (p * q - s * s) / dr.select(largest > 0, largest, 1), 0)
    axis = mi.Vector2f(dr.select(half >= 0, half + root, s), dr.select(half >= 0, s, root - half))
    length = dr.norm(axis)
    axis = dr.select(length > 0, axis / dr.select(length > 0, length, 1), 0)
    return dr.sqrt(dr.maximum(smallest, 0)), dr.abs(e.z) * dr.sqrt(along), dr.sqrt(largest), axis


def canonical(frame: IntervalFrame, d):
    """J⁻¹ d."""
    return mi.Vector3f(dr.dot(frame.a, d), dr.dot(frame.b, d), dr.dot(frame.c, d))
