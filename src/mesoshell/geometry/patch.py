"""Where a ray leaves a prism of the shell: bilinear sides and flat caps (MesoGAN, appendix A; Reshetov 2019).

Notation. All points are relative to the ray's origin, so that a scene far from the world's origin loses nothing.

d            unit direction of the ray; the ray is t·d                                       (3,), world
p0, p1       lower ends of two neighbouring "posts" of a prism, counter-clockwise from above  (3,), world
n0, n1       the posts: p + h·n, h in [0, 1], runs from the base surface to the shell's top   (3,), world
u            position along the side, 0 at post 0 and 1 at post 1
p(u), n(u)   (1−u)·p0 + u·p1 and (1−u)·n0 + u·n1; the side is the patch p(u) + h·n(u)
F(u)         d · (p(u) × n(u)) = a·u² + b·u + c: zero where the ray's line meets post u

F is quadratic in u and F(0), F(1) belong to one post each. F′ at a root is d · (∂P/∂u × ∂P/∂h), and that cross product
points out of the prism, so the ray *leaves* through the root where F grows, u⁺ = (−b + √(b² − 4ac)) / 2a, and enters
through the other: a side has at most one crossing of either kind, with no sorting. The root is evaluated without
cancellation, as c/q or q/a, which also covers the planar patch (a = 0).

`doubt` says that rounding could have changed the answer, because some quantity that is compared with a bound lies closer
to it than its own error bound, or could have moved it by more than 1e-3 of the face. Callers repeat doubtful rays in float64.
"""

from typing import NamedTuple

import jax.numpy as jnp

from mesoshell.numerics import product
from mesoshell.typing import Array, Flag, Float, Mat3, Scalar, Vec3

#: Rounding errors of a 3 × 3 determinant, in units of ε·|p|·|n|: 3 products of 3, 5 sums, and the rounding of p itself.
_ROUNDINGS = 8.0
#: A place whose error bound exceeds this is doubtful: the bounds are at least 7 times the errors seen, so that what
#: float32 keeps is good to 1e-3.
_BLUR = 5e-3


class Crossing(NamedTuple):
    """A crossing with a side or a cap.

    t: distance along the ray. u: position along the side. h: height. inside: how far (u, h), or the barycentric
    coordinates of a cap, lie inside their bounds; negative outside; −inf where there is no crossing at all. margin and
    slack: error bounds of `inside` and of t. doubt: rounding could change whether there is a crossing.
    """

    t: Scalar
    u: Scalar
    h: Scalar
    inside: Scalar
    margin: Scalar
    slack: Scalar
    doubt: Flag


def post_function(d: Vec3, p: Vec3, n: Vec3) -> Scalar:
    """F at a post: d · (p × n). Zero where the ray's line meets the line of the post."""
    return product(d, jnp.cross(p, n))


def leave_side(d: Vec3, p: Float[Array, "2 3"], n: Float[Array, "2 3"], f: Float[Array, "2"]) -> Crossing:
    """Where the ray leaves through the side between posts 0 and 1, given `f` = F at both posts (Reshetov 2019).

    Giving F per post, rather than per side, makes neighbouring sides agree on who owns a ray through their post.
    """
    eps = jnp.finfo(d.dtype).eps
    e, m = p[1] - p[0], n[1] - n[0]
    a = product(d, jnp.cross(e, m))
    c = f[0]
    b = f[1] - f[0] - a
    error = _ROUNDINGS * eps * jnp.max(_length(p)) * jnp.max(_length(n))
    error_d = 4 * error * (jnp.abs(a) + jnp.abs(b) + jnp.abs(c) + error)
    discriminant = b * b - 4 * a * c
    root = jnp.sqrt(jnp.maximum(discriminant, 0))
    q = -(b + jnp.where(b > 0, root, -root)) / 2
    u = jnp.where(b > 0, _divide(c, q), _divide(q, a))
    through = (f[0] < 0) & (f[1] >= 0)  # F changes sign upward: one crossing for certain, whatever rounding says
    u = jnp.where(through, jnp.clip(u, 0, 1), u)
    backward = (f[0] > error) & (f[1] < -error)  # F only falls: the crossing that leaves lies beyond the posts
    exists = through | ((discriminant > 0) & ~backward & jnp.isfinite(u))
    u = jnp.where(exists, u, 0.5)
    q_u, n_u = p[0] + u * e, n[0] + u * m
    dxn = jnp.cross(d, n_u)
    area = product(dxn, dxn)
    t = _divide(product(jnp.cross(q_u, n_u), dxn), area)
    h = _divide(product(jnp.cross(q_u, d), dxn), area)
    sine = jnp.maximum(jnp.sqrt(area), jnp.finfo(d.dtype).tiny)
    margin_u = jnp.where(exists, error / jnp.maximum(root, error), 0)
    margin_h = (_ROUNDINGS * eps * jnp.max(_length(p)) + margin_u * (_length(e) + jnp.abs(h) * _length(m))) / sine
    across = jnp.where(through, jnp.inf, jnp.minimum(u, 1 - u))
    inside = jnp.where(exists, jnp.minimum(across, jnp.minimum(h, 1 - h)), -jnp.inf)
    margin = jnp.maximum(margin_u, margin_h)
    touching = (jnp.abs(discriminant) < error_d) & _between(b, a)
    near_post = jnp.min(jnp.abs(f)) < error
    doubt = touching | near_post | (exists & _unsure(inside, margin))
    return Crossing(t, u, h, inside, margin, margin_h * _length(n_u), doubt)


def leave_cap(d: Vec3, corners: Mat3, outward: int) -> tuple[Crossing, Vec3]:
    """Where the ray leaves through a triangle, counter-clockwise from above; outward is 1 for the top, −1 for the base.

    Returns the crossing (u unused, h = 1 or 0) and the barycentric coordinates there.
    """
    eps = jnp.finfo(d.dtype).eps
    x = jnp.cross(jnp.roll(corners, -1, axis=0), jnp.roll(corners, -2, axis=0))
    w = product(x, d)  # twice the signed areas of the three triangles around the ray, seen along it
    normal = jnp.cross(corners[1] - corners[0], corners[2] - corners[0])
    total = product(normal, d)  # = Σ w, from edges: free of the corners' distance
    leaves = (outward * total) > 0
    size = jnp.max(_length(corners))
    error = _ROUNDINGS * eps * size * size
    weights = _divide(w, jnp.broadcast_to(total, w.shape))
    t = _divide(product(normal, corners[0]), total)
    inside = jnp.where(leaves, jnp.min(weights), -jnp.inf)
    margin = error / jnp.maximum(jnp.abs(total), error)
    doubt = (jnp.abs(total) < 3 * error) | (leaves & _unsure(inside, margin))
    h = jnp.asarray(1.0 if outward > 0 else 0.0, d.dtype)
    slack = _ROUNDINGS * eps * size + margin * _length(normal) / size
    return Crossing(t, jnp.zeros_like(t), h, inside, margin, slack, doubt), weights


def _length(x: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    return jnp.sqrt(jnp.sum(x * x, axis=-1))


def _divide(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    return jnp.where(b == 0, jnp.inf, a / jnp.where(b == 0, 1, b))


def _unsure(inside: Scalar, margin: Scalar) -> Flag:
    """Whether a crossing may or may not lie within its face, or does at a place that rounding has blurred."""
    return (jnp.abs(inside) < margin) | ((inside >= 0) & (margin > _BLUR))


def _between(b: Scalar, a: Scalar) -> Flag:
    """Whether the quadratic's turning point −b/2a lies within the side (or just beside it)."""
    turn = _divide(-b, 2 * a)
    return (turn > -0.01) & (turn < 1.01)
