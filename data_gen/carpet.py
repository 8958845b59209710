"""The recipe `carpet`: tufts of plied yarn that lean the way they are combed, and its restrictions to fewer parameters.

Notation
    tuft      three plies that leave the backing together; a square grid of tufts, PITCH apart
    ply       FIBRES fibres twisted about the ply's own axis
    s         position along a tuft, 0 at the backing and 1 at the cut end (attribute `along`)
    θ         angle between the tuft's axis and the vertical; it grows from the backing upward
    e1, e2    across the axis: in the plane of the lean, and level
    braid     a ply's offset A(s) = a (sin φ e1 + ½ sin 2φ e2), φ = 2π (turns · s + j/3): the three-strand plait

`lean_angle` is a direction in the plane, counted from u toward v, so that a field of it over a surface combs the pile.
`braiding` 0 leaves the plies untwisted and lets their fibres part; 1 plaits them tightly.  `roughness` makes fibres
stray, tufts tilt and lengths uneven.  `density` is the share of tufts that are there.
"""

from collections.abc import Mapping

import numpy as np

from data_gen.nodes import Nodes, Socket
from data_gen.recipe import TOP, Ground, Growth, Parameter, Recipe, Values
from data_gen.scatter import jittered_grid, segments, wander

TUFTS = 64
PLIES, FIBRES = 3, 7
POINTS = 18
PLAIT, YARN, FIBRE = 0.03, 0.0125, 0.0065
TURNS, TWIST = 4.0, 3.0


def grow(rng: np.random.Generator, side: int, values: Values) -> Growth:
    """Every fibre of every tuft: n = tufts · PLIES · FIBRES strands."""
    s = np.linspace(0.0, 1.0, POINTS)
    root = jittered_grid(TUFTS, side, rng, jitter=0.35)
    kept = rng.random(len(root)) < values.get("density", 1.0)
    root = root[kept]
    rough, braid = values["roughness"], values["braiding"]
    m = len(root)
    length = values["length"] * (1.0 - 0.04 * rng.random(m) - 0.3 * rough * rng.random(m))
    axis, e1, e2 = tuft_axes(s, length, values, rng)

    start = rng.uniform(0.0, 1.0, m)[:, None, None]
    phase = 2.0 * np.pi * (braid * TURNS * length[:, None, None] * s + np.arange(PLIES)[:, None] / PLIES + start)
    ply = PLAIT * np.stack([np.sin(phase), (0.5 + 0.35 * (1 - braid)) * np.sin((1 + braid) * phase + 1 - braid)], -1)

    around = np.arange(FIBRES) / (FIBRES - 1)
    spin = -2.0 * np.pi * (braid * TWIST * length[:, None, None, None] * s + around[:, None])
    spin = spin + rng.uniform(0.0, 2.0 * np.pi, (m, PLIES, 1, 1))
    part = YARN * (1.0 + 1.1 * (1.0 - braid) * s**2 + 0.5 * s**8) * (np.arange(FIBRES) > 0)[:, None]
    fibre = part[..., None] * np.stack([np.cos(spin), np.sin(spin)], axis=-1)
    stray = wander(m * PLIES * FIBRES, s, rng).reshape(m, PLIES, FIBRES, POINTS, 2)
    offset = ply[:, :, None] + fibre + (0.002 + 0.05 * rough) * stray

    frame = np.stack([e1, np.broadcast_to(e2[:, None], e1.shape)], axis=-2)[:, None, None]
    base = np.concatenate([root, np.zeros((m, 1))], axis=1)[:, None, None, None]
    points = base + axis[:, None, None] + (offset[..., None] * frame).sum(axis=-2)
    points[..., 2] = np.clip(points[..., 2], 0.0, TOP)
    points = points.reshape(-1, POINTS, 3)
    radius = FIBRE * rng.uniform(0.8, 1.1, len(points))[:, None] * np.where(s < 0.9, 1.0, 0.75)
    tone = np.repeat(rng.random(m), PLIES * FIBRES) * 0.6 + rng.random(len(points)) * 0.4
    return Growth(points, segments(POINTS), s, radius, {"tone": tone})


def tuft_axes(
    s: np.ndarray, length: np.ndarray, values: Values, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes (m, K, 3) from the backing, e1 (m, K, 3) and e2 (m, 3) of m tufts: the comb's lean, and each one's own."""
    m = len(length)
    comb = values["lean"] * np.array([np.cos(values["lean_angle"]), np.sin(values["lean_angle"])])
    lean = comb + (0.06 + 0.45 * values["roughness"]) * rng.normal(size=(m, 2)) * 0.6
    amount = np.hypot(*lean.T)
    direction = lean / np.maximum(amount, 1e-9)[:, None]
    theta = np.minimum(amount, 1.25)[:, None] * (0.25 + 0.75 * np.sqrt(s))
    step = np.diff(s, prepend=0.0) * length[:, None]
    across, up = np.cumsum(np.sin(theta) * step, axis=1), np.cumsum(np.cos(theta) * step, axis=1)
    flat = direction[:, None]
    axis = np.concatenate([across[..., None] * flat, up[..., None]], axis=-1)
    e1 = np.concatenate([np.cos(theta)[..., None] * flat, -np.sin(theta)[..., None]], axis=-1)
    e2 = np.stack([-direction[:, 1], direction[:, 0], np.zeros(m)], axis=1)
    return axis, e1, e2


def surface(n: Nodes, values: Mapping[str, Socket]) -> Socket:
    """Wool: diffuse, a little light through, a soft shine; darker at the backing, no two tufts alike."""
    by_height = n.affine(n.attribute("along"), 0.4, 0.6)
    by_tuft = n.affine(n.attribute("tone"), 0.35, 0.75)
    colour = n.hsv(values["hue"], values["saturation"], n.math("MULTIPLY", by_height, by_tuft, clamp=True))
    r = n.vector("MULTIPLY", colour, (0.6, 0.6, 0.6))
    t = n.vector("MULTIPLY", colour, (0.12, 0.12, 0.12))
    reflect = n.add("ShaderNodeBsdfDiffuse", Color=r).outputs[0]
    transmit = n.add("ShaderNodeBsdfTranslucent", Color=t).outputs[0]
    shine = n.add("ShaderNodeBsdfAnisotropic", Color=(1.0, 1.0, 1.0, 1.0), Roughness=0.55).outputs[0]
    return n.mix(0.04, n.both(reflect, transmit), shine)


PARAMETERS = {
    "length": Parameter("beta", (0.25, 0.95), 0.6, "box heights", "length of the pile along its axis"),
    "lean": Parameter("beta", (0.0, 1.0), 0.5, "rad", "angle from the vertical to which the pile is combed"),
    "lean_angle": Parameter(
        "beta", (0.0, 2.0 * np.pi), 0.0, "rad", "direction it is combed in, from u toward v; periodic"
    ),
    "roughness": Parameter("beta", (0.0, 1.0), 0.15, "1", "0 is neat; 1 has stray fibres, tilted and uneven tufts"),
    "braiding": Parameter("beta", (0.0, 1.0), 0.8, "1", "0 is loose yarn, 1 is plaited tightly"),
    "hue": Parameter("alpha", (0.0, 1.0), 0.58, "turns", "0 and 1 are red, 1/3 is green, 2/3 is blue"),
    "saturation": Parameter("alpha", (0.0, 1.0), 0.55, "1", "0 is undyed, 1 is the pure hue"),
    "density": Parameter("beta", (0.3, 1.0), 1.0, "1", "share of the tufts that are there"),
}
NAMES = {
    "carpet2": ("length", "hue"),
    "carpet4": ("length", "hue", "lean", "lean_angle"),
    "carpet6": ("length", "hue", "lean", "lean_angle", "saturation", "roughness"),
    "carpet": ("length", "hue", "lean", "lean_angle", "saturation", "roughness", "braiding"),
    "carpet8": tuple(PARAMETERS),
}


def restricted(name: str, free: tuple[str, ...]) -> Recipe:
    """The carpet with the parameters `free`; the others stay at their defaults and are not part of the dataset."""
    rest = {key: parameter.default for key, parameter in PARAMETERS.items() if key not in free}

    def grow_free(rng: np.random.Generator, side: int, values: Values) -> Growth:
        return grow(rng, side, {**rest, **values})

    def surface_free(n: Nodes, values: Mapping[str, Socket]) -> Socket:
        return surface(n, {**rest, **values})

    parameters = {key: parameter for key, parameter in PARAMETERS.items() if key in free}
    return Recipe(name, 1, parameters, grow_free, surface_free, Ground((0.3, 0.27, 0.22)), irradiance=14.0, samples=32)


RECIPES = tuple(restricted(name, free) for name, free in NAMES.items())
