"""Where points lie in the prisms of a shell, in float64 and by no code of the engines.

Notation
P(λ, h)     Σ λ_i (b_i + h o_i), i = 0, 1, 2, of a prism's base points b and posts o; λ₂ = 1 − λ₀ − λ₁
J           det ∂P/∂(λ₁, λ₂, h), positive where a prism is not folded
"""

import numpy as np
from jaxtyping import Float, Int

from mesoshell.shell.geometry.extrude import Shell


def prism_point(
    shell: Shell, prism: Int[np.ndarray, "N"], bary: Float[np.ndarray, "N 2"], h: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "N 3"]:
    """P(λ, h) of given prisms, world."""
    b, o = _corners(shell, prism)
    return np.einsum("ik,ikj->ij", _three(bary), b + h.astype(np.float64)[:, None, None] * o)


def invert_prism(
    shell: Shell,
    prism: Int[np.ndarray, "N"],
    x: Float[np.ndarray, "N 3"],
    start: tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N"]] | None = None,
    rounds: int = 20,
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """λ (λ₀, λ₁) and h of points in given prisms by Newton's method, and the distance left, world. start: of λ and h; the
    middle if None."""
    b, o = _corners(shell, prism)
    bary, h = (np.full((len(x), 2), 1 / 3), np.full(len(x), 0.5)) if start is None else start
    bary, h = bary.astype(np.float64), h.astype(np.float64)
    for _ in range(rounds):
        corner = b + h[:, None, None] * o
        weights = _three(bary)
        post, left = np.einsum("ik,ikj->ij", weights, o), x - np.einsum("ik,ikj->ij", weights, corner)
        move = _in_basis(corner[:, 0] - corner[:, 2], corner[:, 1] - corner[:, 2], post, left)
        bary, h = np.clip(bary + move[:, :2], -2, 3), np.clip(h + move[:, 2], -1, 2)
    return bary, h, np.linalg.norm(prism_point(shell, prism, bary, h) - x, axis=1)


def least_jacobian(shell: Shell, heights: int = 11) -> Float[np.ndarray, "P"]:
    """The least J of each prism, as a share of its base times the post there: J is linear in λ, so the least is at a corner."""
    b, o = _corners(shell, np.arange(len(shell.faces)))
    flat = np.linalg.norm(np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]), axis=1)
    least = np.full(len(b), np.inf)
    for h in np.linspace(0, 1, heights):
        corner = b + h * o
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        least = np.minimum(least, (np.einsum("pi,pki->pk", across, o) / np.linalg.norm(o, axis=2)).min(axis=1))
    return least / flat


def _corners(
    shell: Shell, prism: Int[np.ndarray, "N"]
) -> tuple[Float[np.ndarray, "N 3 3"], Float[np.ndarray, "N 3 3"]]:
    """Base points and posts."""
    faces = shell.faces[prism]
    return shell.base[faces].astype(np.float64), shell.offset[faces].astype(np.float64)


def _in_basis(a: np.ndarray, b: np.ndarray, c: np.ndarray, x: np.ndarray) -> Float[np.ndarray, "N 3"]:
    """Coordinates of x along a, b and c, (N, 3) each; 0 where these are linearly dependent."""
    volume = np.einsum("ni,ni->n", a, np.cross(b, c))
    parts = [np.einsum("ni,ni->n", x, np.cross(*pair)) for pair in ((b, c), (c, a), (a, b))]
    return np.stack(parts, axis=1) / np.where(volume == 0, np.inf, volume)[:, None]


def _three(bary: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
    bary = bary.astype(np.float64)
    return np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
