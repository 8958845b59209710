"""The recipe `grass`: curved blades that age from green to straw.

Notation
    R         rows of vertices along a blade: R − 1 pairs and one tip vertex, K = 2R − 1
    t         position along a blade, 0 at the root and 1 at the tip (attribute `along`)
    edge      unit vector across the blade, in the leaf's plane and perpendicular to its curve
    width     full width at the base, in box sides; reach: horizontal distance from root to tip
    a         how dead the leaf is at a point, in [0, 1]
    R, T      diffuse reflectance and transmittance, linear Rec. 709

A blade is a quadratic Bézier curve from the root through a control point above it (so it leaves the ground steeply
and droops) to a tip displaced along its lean.  A leaf bends over its flat side, so the edge starts perpendicular to the
lean, give or take, and twists on the way.  The lawn is tall blades and short undergrowth on jittered grids, so that
cover is even without rows.  Blades are strips of triangles: they render in 0.7 of the time that hair curves take.

A leaf reflects, lets light through and shines a little.  a = clamp(1.5 · age − 0.5 · resist + dry): at age 0 every leaf
is fresh but the dry ones, at age 1 every leaf is dead, and between the two the blades turn one after another.  R and T
go in a from a fresh to a dead leaf; T of a dead leaf is far lower, that is the transparency which age takes away.
Both are multiplied by (0.45 + 0.75 t)(0.75 + 0.5 tone): dark at the root, light at the tip, no two blades alike.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from data_gen.nodes import Nodes, Socket
from data_gen.recipe import TOP, Ground, Growth, Parameter, Recipe, Values
from data_gen.scatter import jittered_grid, unit

ROWS = 7
DRY_SHARE = 0.05
FRESH_R, FRESH_T = (0.075, 0.17, 0.028), (0.10, 0.24, 0.02)
DEAD_R, DEAD_T = (0.34, 0.235, 0.095), (0.085, 0.05, 0.014)
GLOSS, ROUGHNESS = 0.05, 0.45


class Habit(NamedTuple):
    """How a kind of blade grows: blades a patch; ranges of lengths in box sides; twist in radians."""

    count: int
    height: tuple[float, float]
    reach: tuple[float, float]
    width: tuple[float, float]
    twist: float


KINDS = (
    Habit(150, (0.5, TOP), (0.05, 0.4), (0.036, 0.056), 1.0),
    Habit(70, (0.18, 0.45), (0.05, 0.3), (0.028, 0.042), 0.6),
)


def grow(rng: np.random.Generator, side: int, values: Values) -> Growth:
    """A lawn; `age` does not change its geometry."""
    points = np.concatenate([blades(habit, side, rng) for habit in KINDS])
    n = len(points)
    dry = np.where(rng.random(n) < DRY_SHARE, rng.uniform(0.6, 1.0, n), 0.0)
    along = np.append(np.repeat(np.arange(ROWS - 1), 2), ROWS - 1) / (ROWS - 1)
    own = {"tone": rng.random(n), "resist": rng.random(n), "dry": dry}
    return Growth(points, strip_triangles(ROWS), along, None, own)


def blades(habit: Habit, side: int, rng: np.random.Generator) -> np.ndarray:
    """Vertices (n, 2·ROWS − 1, 3) of blades of one kind."""
    root = jittered_grid(habit.count, side, rng)
    n = len(root)
    root = np.concatenate([root, np.zeros((n, 1))], axis=1)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, n)
    lean = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)], axis=1)
    height = rng.uniform(*habit.height, n)
    reach = rng.uniform(*habit.reach, n)
    control = root + lean * (reach * rng.uniform(0.0, 0.35, n))[:, None]
    control[:, 2] = np.minimum(height * rng.uniform(0.6, 1.1, n), TOP)
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


def strip_triangles(rows: int) -> np.ndarray:
    """Triangles (2·rows − 3, 3) of a strip of rows − 1 vertex pairs that ends in one tip vertex."""
    a = 2 * np.arange(rows - 2)
    tip = 2 * (rows - 1)
    lower = np.stack([a, a + 1, a + 3], axis=1)
    upper = np.stack([a, a + 3, a + 2], axis=1)
    return np.concatenate([lower, upper, [[tip - 2, tip - 1, tip]]])


def surface(n: Nodes, values: Mapping[str, Socket]) -> Socket:
    """The leaf: a thin sheet."""
    late = n.math("MULTIPLY_ADD", n.attribute("resist"), -0.5, n.attribute("dry"))
    a = n.math("MULTIPLY_ADD", values["age"], 1.5, late, clamp=True)
    by_height = n.affine(n.attribute("along"), 0.75, 0.45)
    by_blade = n.affine(n.attribute("tone"), 0.5, 0.75)
    shade = n.spread(n.math("MULTIPLY", by_height, by_blade))
    r = n.vector("MULTIPLY", n.lerp(a, FRESH_R, DEAD_R), shade)
    t = n.vector("MULTIPLY", n.lerp(a, FRESH_T, DEAD_T), shade)
    reflect = n.add("ShaderNodeBsdfDiffuse", Color=r).outputs[0]
    transmit = n.add("ShaderNodeBsdfTranslucent", Color=t).outputs[0]
    shine = n.add("ShaderNodeBsdfAnisotropic", Color=(1.0, 1.0, 1.0, 1.0), Roughness=ROUGHNESS).outputs[0]
    return n.mix(GLOSS, n.both(reflect, transmit), shine)


RECIPE = Recipe(
    name="grass",
    version=3,
    parameters={
        "age": Parameter("alpha", (0.0, 1.0), 0.0, "1", "0 is fresh green, 1 is straw; changes albedo and transparency")
    },
    grow=grow,
    surface=surface,
    ground=Ground((0.09, 0.06, 0.035)),
    irradiance=40.0,
    samples=32,
)
