"""Samples on intervals: where they lie in canonical space, and how wide the pixel's cone is there.

Notation
λ, h        barycentric coordinates and height in a prism; P(λ, h) = Σ λ_i (b_i + h n_i)
E           2 × 2: (u, v) = uv₂ + E (λ₀, λ₁)
J⁻¹         inverse of ∂P/∂(u, v, h); as diag(E, 1) · (∂P/∂(λ₀, λ₁, h))⁻¹ it is finite even where a face has no UV area
ℓ           canonical length of an interval, |ξ1 − ξ0|
f           position on an interval, 0 to 1

"Interpolated" coordinates are linear in t between an interval's ends (MesoGAN, appendix A); "exact" ones invert P by
Newton's method, started there.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from mesoshell.numerics import norm, product, safe_div
from mesoshell.render.cone import cone_gaussian
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.texture.footprint import Footprint, footprint
from mesoshell.typing import Array, Mat3, Scalar, Vec2, Vec3


class Chart(NamedTuple):
    """corners: (P, 18), three base points then three posts. uv: (P, 6), the corners' (u, v) in patches."""

    corners: Float[Array, "P 18"]
    uv: Float[Array, "P 6"]


class Piece(NamedTuple):
    """An interval as one row. t: where it begins, and its length, world; bary, h: λ and h at both ends; start: the point where
    it begins, from the prism's third base corner; direction: of the ray, unit. Far from the world's origin, or from the
    ray's, float32 has no room for its ends."""

    prism: Array
    t: Vec2
    bary: Float[Array, "2 2"]
    h: Vec2
    start: Vec3
    direction: Vec3


class Frame(NamedTuple):
    """An interval in canonical space: ξ at both ends, ℓ, and J⁻¹ in its middle."""

    xi0: Vec3
    xi1: Vec3
    length: Scalar
    inverse: Mat3


class Placed(NamedTuple):
    """A sample: ξ and its footprint."""

    xi: Vec3
    footprint: Footprint


def canonical(chart: Chart, prism: Array, bary: Vec2, h: Scalar) -> Vec3:
    """(u, v, h) of a point of a prism."""
    uv = chart.uv[prism].reshape(3, 2)
    return jnp.append(uv[2] + bary[0] * (uv[0] - uv[2]) + bary[1] * (uv[1] - uv[2]), h)


def inverse_jacobian(chart: Chart, prism: Array, bary: Vec2, h: Scalar) -> Mat3:
    """J⁻¹ at a point of a prism."""
    weights = jnp.append(bary, 1 - bary[0] - bary[1])
    e = _edges(chart.uv[prism].reshape(3, 2))
    base, posts = _about_third(chart, prism)
    at = base + h * posts
    back = _inverse_columns(at[0] - at[2], at[1] - at[2], product(weights, posts))
    return jnp.concatenate([product(e, back[:2]), back[2:]])


def _about_third(chart: Chart, prism: Array) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """Base corners of a prism, from the third one, and its posts."""
    row = chart.corners[prism].reshape(6, 3)
    return row[:3] - row[2:3], row[3:]


def _edges(uv: Float[Array, "3 2"]) -> Float[Array, "2 2"]:
    """E."""
    return jnp.stack([uv[0] - uv[2], uv[1] - uv[2]], axis=1)


def _inverse_columns(a: Vec3, b: Vec3, c: Vec3) -> Mat3:
    """Inverse of the matrix with columns a, b, c; zero where it is singular."""
    rows = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    return safe_div(rows, jnp.broadcast_to(product(a, rows[0]), (3, 3)))


def frame(chart: Chart, piece: Piece) -> Frame:
    """The canonical frame of an interval."""
    xi0 = canonical(chart, piece.prism, piece.bary[0], piece.h[0])
    xi1 = canonical(chart, piece.prism, piece.bary[1], piece.h[1])
    inverse = inverse_jacobian(chart, piece.prism, piece.bary.mean(axis=0), piece.h.mean())
    along = product(_edges(chart.uv[piece.prism].reshape(3, 2)), piece.bary[1] - piece.bary[0])
    return Frame(xi0, xi1, norm(jnp.append(along, piece.h[1] - piece.h[0])), inverse)


def place(piece: Piece, at: Frame, f: Scalar, share: Scalar, cone: Scalar) -> Placed:
    """Interpolated sample at position f. share: the part of the interval it stands for; cone: radius at distance 1."""
    g = cone_gaussian(piece.t[0] + f * piece.t[1], share * piece.t[1] / 2, cone)
    xi = at.xi0 + f * (at.xi1 - at.xi0)
    return Placed(xi, footprint(at.inverse, piece.direction, g.along, g.across))


def place_exact(chart: Chart, piece: Piece, f: Scalar) -> Vec3:
    """ξ of the point at position f by four Newton steps on P(λ, h) = x; quadratic, so these exhaust float32."""
    base, posts = _about_third(chart, piece.prism)
    x = piece.start + f * piece.t[1] * piece.direction
    bary = piece.bary[0] + f * (piece.bary[1] - piece.bary[0])
    h = piece.h[0] + f * (piece.h[1] - piece.h[0])
    for _ in range(4):
        at = base + h * posts
        weights = jnp.append(bary, 1 - bary[0] - bary[1])
        off = x - product(weights, at)
        back = _inverse_columns(at[0] - at[2], at[1] - at[2], product(weights, posts))
        move = product(back, off)
        bary, h = bary + move[:2], h + move[2]
    return canonical(chart, piece.prism, bary, h)


class SampleBudget(NamedTuple):
    """How a ray's samples are spread over its intervals. count: samples of each interval; first: number of its first sample
    within the ray; begin: canonical length of the ray before it; step: canonical length a sample stands for; shift: where in
    its share of the ray a sample lies, 0 to 1."""

    count: Int[np.ndarray, "I"]
    first: Int[np.ndarray, "I"]
    begin: Float[np.ndarray, "I"]
    step: Float[np.ndarray, "I"]
    shift: float


def spread(
    i: Intervals, length: Float[np.ndarray, "I"], samples: int, spacing: str, shift: float = 0.5
) -> SampleBudget:
    """Distribute `samples` a ray over its intervals: in proportion to length, or the same number each (at least 1)."""
    new = np.concatenate([[True], i.ray[1:] != i.ray[:-1]]) if len(i.ray) else np.zeros(0, bool)
    start = np.flatnonzero(new)
    group = np.cumsum(new) - 1
    if spacing == "interval":
        number = np.diff(np.append(start, len(i.ray)))[group]
        rank = np.arange(len(i.ray)) - start[group]
        count = np.maximum(((rank + 1) * samples) // number - (rank * samples) // number, 1)
        zero = np.zeros(len(i.ray), np.int64)
        return SampleBudget(count, zero, np.zeros(len(i.ray)), length / count, shift)
    total = np.add.reduceat(length, start) if len(start) else length
    through = np.cumsum(length, dtype=np.float64)
    begin = through - length - (through - length)[start][group]
    step = np.maximum(total, np.finfo(np.float32).tiny)[group] / samples
    edge = np.floor(np.stack([begin, begin + length]) / step + 1 - shift).astype(np.int64)
    last = np.append(new[1:], True) if len(new) else new
    edge[1, last] = samples  # rounding must not lose the last sample of a ray
    edge[0, 1:] = np.where(new[1:], 0, edge[1, :-1])
    return SampleBudget(np.maximum(edge[1] - edge[0], 0), edge[0], begin, step, shift)
