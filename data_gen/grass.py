"""The recipe `grass`: one fixed, periodic lawn.  Geometry in NumPy; Blender is met only in `build`.

Alphabet
    frame     the unit box [0, 1]³, z up; roots at z = 0 in [0, 1)², all of a blade at z ≤ 0.97
    N, R      blades a patch; rows of vertices along a blade (R − 1 pairs and one tip vertex, V = 2R − 1)
    t         position along a blade, 0 at the root and 1 at the tip
    edge      unit vector across the blade, in the leaf's plane and perpendicular to its curve
    width     full width at the base, in box sides; reach: horizontal distance from root to tip

A blade is a quadratic Bézier curve from the root through a control point above it (so it leaves the ground steeply
and droops) to a tip displaced along its lean.  A leaf bends over its flat side, so the edge starts perpendicular to the
lean, give or take, and twists on the way.  The lawn is `TALL` blades and `SHORT` undergrowth on jittered grids, so
that cover is even without rows.  A blade has three colours of its own, as attributes: `tone` (how light), `resist`
(how late it ages) and `dry` (dead from the start; `DRY_SHARE` of the blades).
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from data_gen.recipe import Parameter, Recipe

GEOMETRY_SEED = 20230
TALL, SHORT = 150, 70
ROWS = 7
DRY_SHARE = 0.05
TOP = 0.97


class Blades(NamedTuple):
    """N blades: vertices (N, V, 3), triangles of one blade (F, 3), t (V,), and per blade tone, resist, dry (N,)."""

    vertices: np.ndarray
    triangles: np.ndarray
    along: np.ndarray
    tone: np.ndarray
    resist: np.ndarray
    dry: np.ndarray


class Habit(NamedTuple):
    """How a kind of blade grows: ranges, all lengths in box sides, angles in radians."""

    count: int
    height: tuple[float, float]
    reach: tuple[float, float]
    width: tuple[float, float]
    twist: float


KINDS = (
    Habit(TALL, (0.5, TOP), (0.05, 0.4), (0.036, 0.056), 1.0),
    Habit(SHORT, (0.18, 0.45), (0.05, 0.3), (0.028, 0.042), 0.6),
)


def lawn() -> Blades:
    """The central patch: the same one each time."""
    rng = np.random.default_rng(GEOMETRY_SEED)
    vertices = np.concatenate([grow(habit, rng) for habit in KINDS])
    n = len(vertices)
    return Blades(
        vertices=vertices,
        triangles=strip_triangles(ROWS),
        along=np.append(np.repeat(np.arange(ROWS - 1), 2), ROWS - 1) / (ROWS - 1),
        tone=rng.random(n),
        resist=rng.random(n),
        dry=np.where(rng.random(n) < DRY_SHARE, rng.uniform(0.6, 1.0, n), 0.0),
    )


def grow(habit: Habit, rng: np.random.Generator) -> np.ndarray:
    """Vertices (count, 2·ROWS − 1, 3) of blades of one kind."""
    n = habit.count
    root = jittered_grid(n, rng)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, n)
    lean = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)], axis=1)
    height = rng.uniform(*habit.height, n)
    reach = rng.uniform(*habit.reach, n)
    rise = np.minimum(height * rng.uniform(0.6, 1.1, n), TOP)
    control = root + lean * (reach * rng.uniform(0.0, 0.35, n))[:, None]
    control[:, 2] = rise
    tip = root + lean * reach[:, None]
    tip[:, 2] = height

    t = np.linspace(0.0, 1.0, ROWS)[None, :, None]
    p, q, s = root[:, None], control[:, None], tip[:, None]
    curve = (1 - t) ** 2 * p + 2 * t * (1 - t) * q + t**2 * s
    tangent = unit(2 * (1 - t) * (q - p) + 2 * t * (s - q))

    turn = rng.uniform(-0.6, 0.6, n)[:, None] + rng.uniform(-habit.twist, habit.twist, n)[:, None] * t[0, :, 0]
    flat = unit(np.cross(tangent, lean[:, None] + np.array([0.0, 0.0, 1e-3])))
    edge = np.cos(turn)[..., None] * flat + np.sin(turn)[..., None] * np.cross(tangent, flat)
    half = 0.5 * rng.uniform(*habit.width, n)[:, None, None] * taper(t) * edge

    pairs = np.stack([curve - half, curve + half], axis=2)[:, :-1].reshape(n, -1, 3)
    vertices = np.concatenate([pairs, curve[:, -1:]], axis=1)
    vertices[..., 2] = np.clip(vertices[..., 2], 0.0, TOP)
    return vertices


def taper(t: np.ndarray) -> np.ndarray:
    """Width along the blade over that at the base: a little wider at a third of the way, then down to a point."""
    return 1.0 + 0.5 * t - 1.5 * t**2


def jittered_grid(n: int, rng: np.random.Generator) -> np.ndarray:
    """n points (n, 3) in [0, 1)² × {0}, at most one a cell, in the smallest square grid with n cells."""
    side = int(np.ceil(np.sqrt(n)))
    cell = rng.permutation(side * side)[:n]
    corner = np.stack([cell % side, cell // side], axis=1)
    return np.concatenate([(corner + rng.random((n, 2))) / side, np.zeros((n, 1))], axis=1)


def strip_triangles(rows: int) -> np.ndarray:
    """Triangles (2·rows − 3, 3) of a strip of rows − 1 vertex pairs that ends in one tip vertex."""
    a = 2 * np.arange(rows - 2)
    tip = 2 * (rows - 1)
    lower = np.stack([a, a + 1, a + 3], axis=1)
    upper = np.stack([a, a + 3, a + 2], axis=1)
    return np.concatenate([lower, upper, [[tip - 2, tip - 1, tip]]])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def build() -> Callable[[Mapping[str, float]], None]:
    """Make the slab in Blender's scene; the returned function sets the age."""
    from data_gen import leaf, slab

    group, age = leaf.node_group()
    slab.build(lawn(), group)

    def set_parameters(parameters: Mapping[str, float]) -> None:
        age.outputs[0].default_value = parameters["age"]

    return set_parameters


RECIPE = Recipe(
    name="grass",
    version=2,
    parameters={
        "age": Parameter("alpha", (0.0, 1.0), 0.0, "1", "0 is fresh green, 1 is straw; changes albedo and transparency")
    },
    build=build,
)
