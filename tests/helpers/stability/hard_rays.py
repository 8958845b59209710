"""Rays and shells that are hard to march: far off, grazing, folded, overlapping, mirrored, at edges."""

import numpy as np

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.geometry.tracer import Trace
from tests.helpers.stability.oracles import assert_sorted_apart, locate
from tests.helpers.stability.surfaces import ball, rays_at, sheet, together, torus, unit

BAD = {
    "no direction": ([0, 0, 3], [0, 0, 0]),
    "a direction below every float32": ([0, 0, 3], [0, 0, -1e-60]),
    "a direction beyond every float32": ([0, 0, 3], [0, 0, -1e60]),
    "an infinite direction": ([0, 0, 3], [0, 0, -np.inf]),
    "a NaN in the direction": ([0, 0, 3], [np.nan, 0, -1]),
    "an infinite origin": ([0, 0, np.inf], [0, 0, -1]),
    "a NaN in the origin": ([np.nan, 0, 3], [0, 0, -1]),
    "an origin beyond every float32": ([0, 0, 1e60], [0, 0, -1]),
    "no number at all": ([np.nan] * 3, [np.nan] * 3),
}
OFFSETS = [1e3, 1e4, 1e5]
TOWARD = np.array([0.6, -0.48, 0.64])
SIDE = 9


def surface(height, size: float = 1.0) -> Mesh:
    """A graph z = height(x, y) over the square [-size, size]², grown on its upper side."""
    x, y = (size * g for g in np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(-1, 1, SIDE), indexing="ij"))
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    i = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return check_mesh(points, faces, points[faces][..., :2], "surface")


COUNT = 1500
SHIFT = 3e-7


def grazing(normal: np.ndarray, angle: float, rng: np.random.Generator) -> np.ndarray:
    """Directions that lean outward from a surface by an angle."""
    along = unit(np.cross(normal, rng.normal(size=normal.shape)))
    return unit(along + angle * unit(normal))


def grazed_sides(angle: float, twist: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays through points in and just beside random sides, at an angle to the tangent plane there."""
    e, n0 = unit(rng.normal(size=(COUNT, 3))), 0.3 * unit(rng.normal(size=(COUNT, 3)))
    n0 = n0 - 0.7 * np.sum(n0 * e, axis=1, keepdims=True) * e
    n1 = n0 + twist * 0.3 * unit(rng.normal(size=(COUNT, 3)))
    u, h = rng.uniform(-0.1, 1.1, (2, COUNT, 1))
    normal = np.cross(e + h * (n1 - n0), n0 + u * (n1 - n0))
    d = grazing(normal, angle, rng)
    p0 = rng.uniform(0.1, 4, (COUNT, 1)) * d - (u * e + h * (n0 + u * (n1 - n0)))
    return d.astype(np.float32), np.stack([p0, p0 + e], 1).astype(np.float32), np.stack([n0, n1], 1).astype(np.float32)


POINTS = 4000
OVERLAPPING = "balls whose shells overlap"  # where one cuts the other, λ and h are interpolated
BENT = sheet(lambda x, y: 0.6 * np.cos(3 * x) + 0.1 * y * y)
SCENES = {
    "torus": (torus(), 0.12),
    "two balls": (together(ball(1), ball(1, 0.5, (2.0, 0.3, 0.1))), 0.2),
    OVERLAPPING: (together(ball(1), ball(1, 0.5, (1.6, 0.3, 0.1))), 0.2),
    "bent sheet": (BENT, 0.15),
}


def assert_as_sampled(trace: Trace, shell: Shell, o: np.ndarray, d: np.ndarray, reach: float) -> np.ndarray:
    """Compare with the oracle up to each ray's end; returns the number of separate visits of each ray."""
    i = trace.intervals
    assert_sorted_apart(trace)
    visits = np.zeros(len(o), int)
    for r in range(len(o)):
        last = min(trace.end[r], reach)
        t = (np.arange(POINTS) + 0.5) * last / POINTS
        held = locate(shell, o[r] + t[:, None] * d[r])
        t0, t1, prism = i.t0[i.ray == r], i.t1[i.ray == r], i.prism[i.ray == r]
        covers = (t[:, None] >= t0) & (t[:, None] < t1)
        ends = np.concatenate([t0, t1, [0, last]])
        clear = np.asarray(np.abs(t[:, None] - ends).min(axis=1) > last / POINTS)
        inside = np.any(held, axis=1).astype(int)
        np.testing.assert_array_equal(np.any(covers, axis=1).astype(int)[clear], inside[clear], f"ray {r}")
        point, interval = np.nonzero(covers & clear[:, None])
        assert held[point, prism[interval]].all(), f"ray {r}: wrong prism"
        visits[r] = np.sum(np.diff(inside, prepend=0) > 0)
    return visits


def rays_through(mesh: Mesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rays_at(
        mesh.vertices[rng.integers(0, len(mesh.vertices), count)] + 0.1 * rng.normal(size=(count, 3)), 3, rng
    )


ROUND, UP = 16, 4


def mirrored(mesh: Mesh) -> Mesh:
    """The same surface with u turned over."""
    return check_mesh(mesh.vertices, mesh.faces, mesh.uv * np.array([-1, 1]), "mirrored")


def cylinder() -> Mesh:
    """Around z, without ends; u runs once round from 0 to 1 at angle 0, v upward."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(ROUND), np.arange(UP), indexing="ij"))
    angle = 2 * np.pi * np.repeat(np.arange(ROUND), UP + 1) / ROUND
    points = np.stack([np.cos(angle), np.sin(angle), np.tile(np.arange(UP + 1) / UP, ROUND)], axis=1)

    def corner(di: int, dj: int) -> tuple[np.ndarray, np.ndarray]:
        return (i + di) % ROUND * (UP + 1) + j + dj, np.stack([(i + di) / ROUND, (j + dj) / UP], axis=1)

    (a, p), (b, q), (c, r), (d, s) = corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return check_mesh(points, faces, np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)]), "cylinder")


PART = 10000  # rays at a time: the oracle holds a number for each ray and face
FAR = (148376.0, 1234.0, -223423.0)


def targets(shell: Shell, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points in equal parts on vertices, posts, edges of the base and of the top, and sides."""
    base, post = shell.base.astype(np.float64), shell.offset.astype(np.float64)
    kind = np.arange(count) % 5
    face, k = rng.integers(0, len(shell.faces), count), rng.integers(0, 3, count)
    i, j = shell.faces[face, k], shell.faces[face, (k + 1) % 3]
    u = np.where(kind < 2, 0, rng.uniform(size=count))[:, None]
    h = np.select([kind == 0, kind == 2, kind == 3], [np.arange(count) // 5 % 2, 0, 1], rng.uniform(size=count))[
        :, None
    ]
    return (1 - u) * (base[i] + h * post[i]) + u * (base[j] + h * post[j])


KINDS = {"equal": 300, "trapezoid": 300, "twisted": 300}


def sides(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions, feet and posts, relative to the rays' origins; every ray leaves through its side's interior."""
    count = KINDS[kind]
    rng = np.random.default_rng(len(kind))
    e, n0 = unit(rng.normal(size=(count, 3))), rng.normal(size=(count, 3))
    n0 = 0.3 * unit(n0 - 0.8 * np.sum(n0 * e, axis=1, keepdims=True) * e)
    outward = unit(np.cross(e, n0))
    n1 = n0 + {"equal": 0, "trapezoid": 0.2, "twisted": 0}[kind] * n0 + (1e-6 * outward if kind == "twisted" else 0)
    u, h = rng.uniform(0.02, 0.98, (2, count, 1))
    d = unit(rng.normal(size=(count, 3)))
    lean = np.sum(d * outward, axis=1, keepdims=True)
    d = unit(d + (np.sign(lean) * np.maximum(np.abs(lean), 0.1) - lean) * outward) * np.sign(lean)
    p0 = rng.uniform(0.5, 3, (count, 1)) * d - (u * e + h * (n0 + u * (n1 - n0)))
    return d.astype(np.float32), np.stack([p0, p0 + e], 1).astype(np.float32), np.stack([n0, n1], 1).astype(np.float32)
