"""The prism walk: every interval of a ray inside the shell (MesoGAN, appendix A).

A ray that has entered a prism leaves it through one of three sides, the top or the base; through a side it enters the
neighbour, and so on until it leaves the shell. One step of the walk is one prism and yields one interval.

Notation
o, d        ray origin and unit direction                                         (3,), world
t           distance from the ray's origin                                        world
λ           barycentric coordinates in a prism's triangle, (λ₀, λ₁); λ₂ = 1 − λ₀ − λ₁
h           relative height, 0 on the base surface and 1 on the top
face code   0, 1, 2: the side from vertex k to k + 1;  3: top;  4: base

Where rounding leaves no face that the ray can leave through, the walk takes the face that is missed by least; where all
are missed by far, it ends as lost. Such rays, and all whose decisions lie within their own rounding error, are marked
`doubt`, and `batched_walk.py` repeats them in float64. The origin is given as a sum of two floats, so that it can lie on
the ray right at the shell: positions relative to it are then small, and so are their errors.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.geometry.patch import Crossing, leave_cap, leave_side, post_function
from mesoshell.typing import Array, Flag, Float, Index, Int, Scalar, Vec2, Vec3

TOP, BASE = 3, 4
#: Exit codes of a walk that has not ended, of one that is outside every prism, and of one that is about to enter its first.
WALKING, LOST, ENTERING = -1, -2, -3
#: No face is met beyond its bounds by more than this, whatever its error bound.
WIDEST = 1e-3
#: A ray that misses every face by more than this is not in the prism: its walk ends there. (In a scene 1e5 away from the
#: origin, a ray's point is exact to 1e-11 in float64.)
FAR_OFF = 1e-6
#: Rows of the smallest table; each next one has twice as many.
LEAST = 1024


class Prisms(NamedTuple):
    """The shell as lookup tables, one wide row a prism.

    corners: base and post of the three vertices, (P, 18) as [base₀, base₁, base₂, post₀, post₁, post₂].
    across: (P, 6), the neighbouring prism across each side (−1: none), then which of its sides that is.
    """

    corners: Float[Array, "P 18"]
    across: Int[Array, "P 6"]


class Ray(NamedTuple):
    """origin + residual is the origin (residual holds what origin's float32 cannot); direction is a unit vector."""

    origin: Vec3
    residual: Vec3
    direction: Vec3


class WalkState(NamedTuple):
    """State of a walk: prism, distance and its error bound, λ and h where it entered the prism, exit code, doubt."""

    prism: Index
    t: Scalar
    slack: Scalar
    bary: Vec2
    h: Scalar
    exit: Index
    doubt: Flag


class Interval(NamedTuple):
    """One prism's part of a ray: from t0 to t1, with λ and h at both ends."""

    prism: Index
    t0: Scalar
    t1: Scalar
    bary0: Vec2
    h0: Scalar
    bary1: Vec2
    h1: Scalar


def _local(prisms: Prisms, ray: Ray, prism: Index) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Base points relative to the ray's origin, and posts, in the ray's precision."""
    row = prisms.corners[prism].reshape(6, 3).astype(ray.direction.dtype)
    return (row[:3] - ray.origin[None]) - ray.residual[None], row[3:]


def enter(prisms: Prisms, ray: Ray, prism: Index, code: Index) -> WalkState:
    """The place where a ray enters `prism` through face `code` (an outer face: top, base, or a side at a border).

    An intersector reports top and base, so they are trusted; at a side, only an exact crossing counts.
    """
    p, n = _local(prisms, ray, prism)
    d = ray.direction
    top, weights_top = leave_cap(d, p + n, outward=-1)
    base, weights_base = leave_cap(d, p, outward=1)
    k = jnp.clip(code, 0, 2)
    posts = jnp.stack([(k + 1) % 3, k])  # the side seen from outside: its leaving is our entering
    f = jax.vmap(post_function, in_axes=(None, 0, 0))(d, p, n)
    side = leave_side(d, p[posts], n[posts], f[posts])
    bary_side = _along_side(k, side.u, 1 - side.u)
    is_top, is_base = code == TOP, code == BASE
    t = jnp.where(is_top, top.t, jnp.where(is_base, base.t, side.t))
    bary = jnp.where(is_top, weights_top, jnp.where(is_base, weights_base, bary_side))[:2]
    h = jnp.where(is_top, 1.0, jnp.where(is_base, 0.0, side.h))  # a cap's h is that of its face seen from inside
    met = jnp.where(code < TOP, side.inside >= 0, True) & jnp.isfinite(t)
    doubt = jnp.where(is_top, top.doubt, jnp.where(is_base, base.doubt, side.doubt))
    exit_ = jnp.where(met, WALKING, LOST).astype(prism.dtype)
    slack = jnp.where(is_top, top.slack, jnp.where(is_base, base.slack, side.slack))
    return WalkState(prism, t, slack, jnp.where(met, bary, 0.0), jnp.clip(h, 0, 1), exit_, doubt)


def begun(prisms: Prisms, ray: Ray, code: Index, place: WalkState) -> WalkState:
    """The place of a walk, where it enters by `code` if it is about to."""
    entered = enter(prisms, ray, place.prism, code)
    return jax.tree.map(lambda new, old: jnp.where(place.exit == ENTERING, new, old), entered, place)


def step(prisms: Prisms, ray: Ray, place: WalkState) -> tuple[WalkState, Interval]:
    """Cross one prism: the interval inside it, and the place after it. A walk that has ended stays where it is."""
    p, n = _local(prisms, ray, place.prism)
    d = ray.direction
    f = jax.vmap(post_function, in_axes=(None, 0, 0))(d, p, n)
    pair = jnp.array([[0, 1], [1, 2], [2, 0]])
    sides = jax.vmap(leave_side, in_axes=(None, 0, 0, 0))(d, p[pair], n[pair], f[pair])
    top, weights_top = leave_cap(d, p + n, outward=1)
    base, weights_base = leave_cap(d, p, outward=-1)
    faces = jax.tree.map(lambda s, a, b: jnp.concatenate([s, a[None], b[None]]), sides, top, base)
    code, doubt, lost = _choose(faces, place)
    t1 = jnp.where(lost, place.t, jnp.maximum(_pick(faces.t, code), place.t))
    u = jnp.clip(_pick(faces.u, code), 0, 1)
    edge = jnp.minimum(code, 2)
    bary_side = _along_side(edge, 1 - u, u)
    bary1 = jnp.where(code == TOP, weights_top, jnp.where(code == BASE, weights_base, bary_side))[:2]
    h1 = jnp.clip(_pick(faces.h, code), 0, 1)
    interval = Interval(place.prism, place.t, t1, place.bary, place.h, bary1, h1)
    across = prisms.across[place.prism]
    beyond = jnp.where(code < TOP, _pick(across[:3], edge), -1)
    bary2 = _along_side(_pick(across[3:], edge), u, 1 - u)[:2]
    stays = beyond < 0
    after = WalkState(
        jnp.where(stays, place.prism, beyond),
        t1,
        _pick(faces.slack, code),
        jnp.where(stays, bary1, bary2),
        h1,
        jnp.where(lost, LOST, jnp.where(stays, code, WALKING)).astype(place.exit.dtype),
        place.doubt | doubt,
    )
    walking = place.exit == WALKING
    return jax.tree.map(lambda new, old: jnp.where(walking, new.astype(old.dtype), old), after, place), interval


def _choose(faces: Crossing, place: WalkState) -> tuple[Index, Flag, Flag]:
    """Which face the ray leaves through: the nearest one ahead whose bounds it meets, else the one it misses by least.

    Bounds are widened by rounding: a ray through an edge may miss both of its faces by that much, and meet one further on.
    Returns the face, doubt, and whether even the face that is missed by least is missed by far: the ray is not in here.
    """
    slack = 64 * jnp.finfo(place.t.dtype).eps * jnp.abs(place.t) + place.slack
    slack = slack + jnp.where(jnp.isfinite(faces.t), faces.slack, 0)
    ahead = jnp.isfinite(faces.t) & (faces.t >= place.t - slack) & (faces.inside > -jnp.inf)
    meets = ahead & (faces.inside >= -jnp.minimum(faces.margin, WIDEST))
    nearest = jnp.argmin(jnp.where(meets, faces.t, jnp.inf))
    missed = jnp.where(ahead, jnp.nan_to_num(faces.inside, nan=-1e30), -jnp.inf)
    code = jnp.where(jnp.any(meets), nearest, jnp.argmax(missed))
    near = slack + _pick(slack, code)
    t_out = _pick(faces.t, code)
    relevant = faces.doubt & (faces.t <= t_out + near) & (faces.t >= place.t - slack)
    close = meets & (jnp.abs(faces.t - t_out) <= near)
    doubt = jnp.any(relevant) | ~jnp.any(meets) | (jnp.sum(close) > 1)
    return code, doubt, ~jnp.any(meets) & (jnp.max(missed) < -FAR_OFF)


def _pick(x: Array, i: Index) -> Array:
    """x[i] for a short x: a sum under a mask, which vectorises where a gather does not."""
    chosen = jnp.arange(x.shape[0], dtype=i.dtype) == i
    return jnp.sum(jnp.where(chosen, x, jnp.zeros_like(x)), dtype=x.dtype)


def _along_side(edge: Index, first: Scalar, second: Scalar) -> Vec3:
    """Barycentric coordinates with `first` at vertex `edge` and `second` at the next."""
    k = jnp.arange(3, dtype=edge.dtype)
    return jnp.where(k == edge, first, jnp.where(k == (edge + 1) % 3, second, jnp.zeros_like(first)))


@partial(jax.jit, inline=True)
def _steps(prisms: Prisms, rays: Ray, places: WalkState) -> tuple[WalkState, Interval]:
    """`step` of many rays. What is jitted is traced once, however often it is called."""
    return jax.vmap(step, in_axes=(None, 0, 0))(prisms, rays, places)


def walk(prisms: Prisms, rays: Ray, start: WalkState, steps: int) -> tuple[WalkState, Interval, Int[Array, "R"]]:
    """At most `steps` prisms of every ray, in lock-step; ends early once every ray has ended.

    rays, start: one row a ray. Returns where each ray stands (exit code WALKING: call again with this as `start`), its
    intervals as (steps, R) rows, and how many of these rows count.
    """
    count = rays.direction.shape[0]
    shapes = jax.eval_shape(_steps, prisms, rays, start)[1]
    empty = jax.tree.map(lambda s: jnp.zeros((steps, *s.shape), s.dtype), shapes)

    def body(carry: tuple) -> tuple:
        i, place, rows, used = carry
        walking = place.exit == WALKING
        place, interval = _steps(prisms, rays, place)
        rows = jax.tree.map(lambda all_, new: all_.at[i].set(new), rows, interval)
        return i + 1, place, rows, used + walking.astype(used.dtype)

    def cond(carry: tuple) -> Flag:
        i, place, _, _ = carry
        return (i < steps) & jnp.any(place.exit == WALKING)

    zero = jnp.zeros((), jnp.int32)
    _, place, rows, used = jax.lax.while_loop(cond, body, (zero, start, empty, jnp.zeros(count, jnp.int32)))
    return place, rows, used


def as_tables(shell_base, shell_offset, faces, neighbour, neighbour_edge) -> Prisms:
    """Lookup tables of an extruded shell (arrays as in `shell/geometry/extrude.py`)."""
    corners = np.concatenate([shell_base[faces].reshape(-1, 9), shell_offset[faces].reshape(-1, 9)], axis=1)
    across = np.concatenate([neighbour, np.maximum(neighbour_edge, 0)], axis=1)
    return Prisms(jnp.asarray(table(corners, np.float32)), jnp.asarray(table(across, np.int32)))


def table(x: np.ndarray, dtype: type) -> np.ndarray:
    """Rows of prisms, followed by zeros: what is compiled for one number of rows serves all meshes that have it."""
    rows = max(LEAST, 1 << (len(x) - 1).bit_length())
    padded = np.zeros((rows, x.shape[1]), dtype)
    padded[: len(x)] = x
    return padded
