"""The recipe `fur`: a dense, fine undercoat below longer, tapered guard hairs.

Notation
    t         position along a hair, 0 at the root and 1 at the tip (attribute `along`)
    length    of the longest hair, in box heights
    clump     hairs whose tips lean together, as wet or oily fur does; a jittered grid of centres
    guard     1 for a guard hair, 0 for the undercoat (attribute)

A hair rises, leans with a smooth random field over the skin (whorls, no direction preferred), is drawn to its clump's
centre toward the tip and wanders.  `roughness` scales the wandering, loosens the clumps and makes lengths uneven.
The undercoat is paler, and a guard hair darkens from its middle to the tip.

Light meets a hair in three ways, whose weights add up to less than 1: a lobe reflected at the cuticle, untinted; a lobe
through the hair; and what the medulla scatters to all sides, which fur has and human hair has not.  Cycles' lobes for hair
fibres are drawn; its principled hair costs 2.4 times as much a path and leaves ten times the error (docs/results/datasets.md).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from data_gen.nodes import Nodes, Socket
from data_gen.recipe import TOP, Ground, Growth, Parameter, Recipe, Values
from data_gen.scatter import field, jittered_grid, nearest, segments, wander

POINTS = 8
CLUMPS = 30
WHORLS = (0.6, 1.7)
MEDULLA, THROUGH, SHINE = 0.45, 0.45, 0.08
LOBES = {"RoughnessU": 0.4, "RoughnessV": 1.0}


class Coat(NamedTuple):
    """Hairs a patch; share of the length; radius at the root in box sides, that at the tip over it; what moves them."""

    count: int
    length: tuple[float, float]
    radius: float
    tip: float
    gather: float
    curl: float


UNDER = Coat(1500, (0.5, 0.7), 0.004, 0.4, 0.5, 0.03)
GUARD = Coat(700, (0.75, 1.0), 0.0065, 0.12, 0.8, 0.008)


def grow(rng: np.random.Generator, side: int, values: Values) -> Growth:
    """Both coats."""
    t = np.linspace(0.0, 1.0, POINTS)
    centres = jittered_grid(CLUMPS, side, rng)
    whorls = rng.spawn(1)[0]
    seed = whorls.integers(2**63)
    coats = [hairs(coat, t, centres, seed, side, values, rng) for coat in (UNDER, GUARD)]
    points, radius, clump = (np.concatenate(x) for x in zip(*coats, strict=True))
    n = len(points)
    guard = np.repeat([0.0, 1.0], [UNDER.count * side**2, GUARD.count * side**2])
    tone = 0.4 * rng.random(n) + 0.6 * rng.random(len(centres))[clump]
    return Growth(points, segments(POINTS), t, radius, {"guard": guard, "tone": tone})


def hairs(
    coat: Coat, t: np.ndarray, centres: np.ndarray, whorls: int, side: int, values: Values, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, K, 3), radii (n, K) and clump (n,) of one coat."""
    rough = values["roughness"]
    root = jittered_grid(coat.count, side, rng)
    n = len(root)
    uneven = 1.0 - rough * 0.45 * rng.random(n)
    length = values["length"] * rng.uniform(*coat.length, n) * uneven
    clump, way = nearest(root, centres, side)
    lean = 0.6 * field(root, side, np.random.default_rng(whorls), WHORLS) + 0.06 * rng.normal(size=(n, 2))
    bend = np.tanh(np.hypot(*lean.T))[:, None] * 0.75
    direction = lean / (np.hypot(*lean.T)[:, None] + 1e-9)
    angle = bend * (0.35 + 0.65 * t)
    step = np.diff(t, prepend=0.0) * length[:, None]
    across = np.cumsum(np.sin(angle) * step, axis=1)[..., None] * direction[:, None]
    reach = np.minimum(coat.gather * (1.0 - 0.6 * rough), 1.5 * length)
    gathered = reach[:, None, None] * (t**1.6)[None, :, None] * way[:, None]
    amount = length * (coat.curl + 0.16 * rough * rng.random(n))
    curl = amount[:, None, None] * wander(n, t, rng)
    points = np.empty((n, POINTS, 3))
    points[..., :2] = root[:, None] + across + gathered + curl
    points[..., 2] = np.minimum(np.cumsum(np.cos(angle) * step, axis=1), TOP)
    radius = coat.radius * rng.uniform(0.8, 1.2, n)[:, None] * (1.0 - (1.0 - coat.tip) * t**2)
    return points, radius, clump


def surface(n: Nodes, values: Mapping[str, Socket]) -> Socket:
    """A hair: reflected, transmitted and scattered light."""
    along, guard = n.attribute("along"), n.attribute("guard")
    tip = n.math("MULTIPLY", guard, n.math("POWER", along, 3.0))
    by_hair = n.affine(n.attribute("tone"), 0.7, 0.55)
    by_length = n.math("MULTIPLY_ADD", tip, -0.45, n.affine(along, 0.35, 0.65))
    value = n.math("MULTIPLY", values["value"], n.math("MULTIPLY", by_hair, by_length), clamp=True)
    saturation = n.math("MULTIPLY", values["saturation"], n.affine(guard, 0.3, 0.7))
    colour = n.hsv(values["hue"], saturation, value)
    medulla = n.add("ShaderNodeBsdfDiffuse", Color=n.vector("MULTIPLY", colour, (MEDULLA,) * 3)).outputs[0]
    through = n.add("ShaderNodeBsdfHair", Color=n.vector("MULTIPLY", colour, (THROUGH,) * 3), **LOBES)
    through.component = "Transmission"
    shine = n.add("ShaderNodeBsdfHair", Color=(SHINE, SHINE, SHINE, 1.0), **LOBES)
    shine.component = "Reflection"
    return n.both(medulla, n.both(through.outputs[0], shine.outputs[0]))


RECIPE = Recipe(
    name="fur",
    version=1,
    parameters={
        "length": Parameter("beta", (0.25, 0.95), 0.65, "box heights", "length of the guard hairs"),
        "roughness": Parameter("beta", (0.0, 1.0), 0.2, "1", "0 is sleek and clumped, 1 is frizzy and uneven"),
        "hue": Parameter("alpha", (0.0, 1.0), 0.08, "turns", "hue of the coat: 0 and 1 are red, 1/3 is green"),
        "saturation": Parameter("alpha", (0.0, 1.0), 0.7, "1", "0 is grey, 1 is the pure hue"),
        "value": Parameter("alpha", (0.05, 0.95), 0.6, "1", "lightness of the coat: its strongest channel"),
    },
    grow=grow,
    surface=surface,
    ground=Ground((0.35, 0.22, 0.17)),
    irradiance=14.0,
    samples=32,
)
