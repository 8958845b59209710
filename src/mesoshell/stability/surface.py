"""Checks of the mesh and of the shell that stands on it.

Notation
T           thickness asked for                                                         world
J           Jacobian of a prism's map (prisms.py)
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh, count_of
from mesoshell.geometry.patch import leave_side, post_function
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.stability.checks import Check
from mesoshell.stability.prisms import least_jacobian
from mesoshell.typing import Array

#: Steps of the mesh's float32 coordinates, in T: more, and the shell is stepped.
GRID = 1e-3
#: Sides that are tried; the share of its size by which a near-planar side's fourth corner is off the plane of the others, at
#: most; how far a place on a side may be off.
SIDES, PLANAR, PLACE = 50_000, 1e-4, 1e-3


def of_mesh(mesh: Mesh) -> Check:
    """What was mended."""
    return Check(
        "mesh", f"{count_of(len(mesh.faces), 'face')}; " + ("; ".join(mesh.notes) or "nothing mended"), 0.0, None
    )


def of_grid(points: Float[np.ndarray, "V 3"], T: float, unit: str = "thickness") -> Check:
    """How fine the mesh's coordinates are, so far from the origin. unit: what T is."""
    step = float(np.spacing(np.abs(points).max()))
    line = f"the mesh's coordinates are rounded to {step / T:.1g} of the {unit}"
    return Check("offset", line, step / T, GRID)


def of_folds(shell: Shell) -> Check:
    """Whether a prism is folded."""
    least = least_jacobian(shell)
    folded = (~(least > 0)).sum()
    line = f"{folded} of {count_of(len(least), 'prism')} folded; the least Jacobian keeps {least.min():.2g} of its base"
    return Check("folds", line, float(folded), 0.0)


def of_thickness(shell: Shell, T: float, wanted: int) -> Check:
    """Where the shell is thinner than asked for. wanted: faces of the mesh."""
    kept = np.linalg.norm(shell.offset.astype(np.float64), axis=1) / T
    thin = kept < 1 - 1e-6
    line = f"{thin.sum()} of {count_of(len(kept), 'vertex', 'vertices')} thinned" + (
        f", to {kept.min():.2g} at least" if thin.any() else ""
    )
    without = wanted - len(shell.faces)
    return Check("thickness", line + (f"; {count_of(without, 'face')} without a prism" if without else ""), 0.0, None)


def of_chart(shell: Shell) -> Check:
    """Where texture coordinates jump, turn over or have no area."""
    prism, k = np.nonzero(shell.neighbour >= 0)
    other, edge = shell.neighbour[prism, k], shell.neighbour_edge[prism, k]
    apart = np.abs(shell.uv[prism, k] - shell.uv[other, (edge + 1) % 3]).max(axis=1)
    apart = np.maximum(apart, np.abs(shell.uv[prism, (k + 1) % 3] - shell.uv[other, edge]).max(axis=1))
    u, v = np.moveaxis(shell.uv[:, 1:].astype(np.float64) - shell.uv[:, :1], 1, 0)
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    line = f"seams along {(apart > 1e-5).mean() if len(apart) else 0:.1%} of inner edges"
    line += f"; {(area < 0).sum()} prisms mirrored, {(area == 0).sum()} without area in UV"
    return Check("chart", line, 0.0, None)


def of_sides(shell: Shell, rng: np.random.Generator) -> Check:
    """Rays out through known places of sides, in float32: an answer that is off must be in doubt (and is then redone in
    float64). For comparison, the quadratic as it is in textbooks."""
    count = min(SIDES, 3 * len(shell.faces))
    chosen = rng.permutation(3 * len(shell.faces))[:count]
    prism, k = chosen // 3, chosen % 3
    ends = np.stack([shell.faces[prism, k], shell.faces[prism, (k + 1) % 3]], axis=1)
    foot, post = shell.base[ends].astype(np.float64), shell.offset[ends].astype(np.float64)
    u, h = rng.uniform(0.02, 0.98, (2, count))
    e, m = foot[:, 1] - foot[:, 0], post[:, 1] - post[:, 0]
    at_u, at_h = post[:, 0] + u[:, None] * m, e + h[:, None] * m
    outward = np.cross(at_h, at_u)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    across = np.linalg.norm(e, axis=1)
    lean = np.einsum("si,si->s", np.cross(e, post[:, 0]), post[:, 1])
    planar = np.abs(lean) < PLANAR * across * (np.linalg.norm(post, axis=2) ** 2).max(axis=1)
    d = outward + rng.normal(size=outward.shape) * 0.5
    d -= np.minimum(np.einsum("si,si->s", d, outward) - 0.1, 0)[:, None] * outward
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    size = across + np.linalg.norm(post, axis=2).max(axis=1)
    at = foot[:, 0] + u[:, None] * e + h[:, None] * at_u
    near = (foot - (at - 2 * size[:, None] * d)[:, None]).astype(np.float32)
    place, inside, doubt, naive = (np.asarray(x) for x in _left(d, near, post.astype(np.float32)))
    true = np.stack([u, h], axis=1)
    wrong = ~((np.abs(place - true).max(axis=1) <= PLACE) & (inside >= 0))
    missed = ~(np.abs(naive - u) <= PLACE)
    line = f"{(wrong & ~doubt).sum()} of {count} places on sides wrong and not in doubt; {doubt.mean():.2%} in doubt"
    line += f"; {planar.mean():.1%} of sides near-planar; the textbook's quadratic would miss {missed.mean():.2%}"
    return Check("sides", line, float((wrong & ~doubt).sum()), 0.0)


@jax.jit
def _left(
    d: Float[Array, "S 3"], p: Float[Array, "S 2 3"], n: Float[Array, "S 2 3"]
) -> tuple[Float[Array, "S 2"], Float[Array, "S"], Array, Float[Array, "S"]]:
    """Where rays from 0 leave through sides: (u, h), how far inside, whether in doubt; and the textbook's u."""
    f = jax.vmap(jax.vmap(post_function, in_axes=(None, 0, 0)))(d, p, n)
    leaving = jax.vmap(leave_side)(d, p, n, f)
    e, m = p[:, 1] - p[:, 0], n[:, 1] - n[:, 0]
    a = jnp.sum(d * jnp.cross(e, m), axis=1)
    b, c = f[:, 1] - f[:, 0] - a, f[:, 0]
    naive = (-b + jnp.sqrt(b * b - 4 * a * c)) / (2 * a)
    return jnp.stack([leaving.u, leaving.h], axis=1), leaving.inside, leaving.doubt, naive
