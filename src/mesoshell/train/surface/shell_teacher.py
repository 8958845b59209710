"""A neural shell as the teacher of a surface material: queries marched through it on a cylinder.

Notation
D            thickness of the shell in patches; the surface material's period is a patch
κ            curvature of the bounding surface, the shell's top                                              1 / patch
x, z         place in the plane across the axis: the ray enters at 0, x runs across, z outward               patches
t            distance from where the ray enters, against ω
η            height over the bounding surface, −D to 0: (κ (x² + z²) + 2 z) / (1 + √(κ²x² + (1 + κz)²))
s            arc length on the bounding surface: atan2(κx, 1 + κz) / κ
G            D (2 − κD): the body is met where κt² − 2 ω_z t + G = 0, the surface again where t = 2 ω_z / κ
J            columns (1 + κη) ŝ, ŷ, D n̂: from canonical (u, v, h) of the shell, h = 1 + η/D, to patches

A query's footprint is a Gaussian about its place on the bounding surface (datasets/queries/trace). Three quarters of its
variance come from the filter along the marched ray, a quarter from random places of rays: at flat angles the filter alone
leaves out what lies beside the ray.

Of corner tiles each placement shows a patch of the plane of its own, so that what is learned is the mean of all tiles.

Samples are spaced equally in t, each with its canonical length, as in training. Light that the base surface reflects crosses
the shell twice; on the way to the light the shell counts as flat (shell/render/lighting).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.numerics import normalise, optical_depth, product
from mesoshell.render.composite import weights
from mesoshell.shell.material.field import Field, Layout, Material, Point, neural_field
from mesoshell.texture.footprint import footprint
from mesoshell.typing import Array, Float, Scalar, Vec3

#: Samples a ray, and on the way from the base surface to a light; queries a batch.
SAMPLES, BASE_SAMPLES, BATCH = 64, 8, 1024
#: Patches along a side of the plane of corner tiles that are shown.
PLANE = 1024
#: Least cosine of light on the base surface: light crosses at most 20 heights (shell/render/lighting).
FLATTEST = 0.05


class LocalQuery(NamedTuple):
    """One query: where its ray enters, (s, y) from the patch's middle; the footprint's standard deviation; ω and ω′ in the
    frame there."""

    place: Float[Array, "2"]
    radius: Scalar
    toward: Vec3
    light: Vec3


class DevicePlacement(NamedTuple):
    """How the patch lies: κ, and (u, v) = turn (s, y) + shift."""

    curvature: Scalar
    turn: Float[Array, "2 2"]
    shift: Float[Array, "2"]


class Teacher(NamedTuple):
    """A shell's material with its appearance parameters, its thickness, and the albedo of the surface under it."""

    material: Material
    alpha: Float[Array, "A"]
    depth: Scalar
    base: Vec3


def answers(layout: Layout, teacher: Teacher):
    """Answers for datasets/queries/render: α, the cosine at which a ray grazes the body, and L / E⊥."""

    def of(placing: Any, query: dict[str, np.ndarray], seed: int):
        c, s = np.cos(placing.turn), np.sin(placing.turn)
        shift = np.array(placing.shift)
        if layout.colours is not None:
            shift = shift + np.floor(shift * PLANE**2) % PLANE  # whole patches, by digits that place nothing within one
        values = placing.curvature, np.array([[c, -s], [s, c]]), shift
        placement = DevicePlacement(*(jnp.asarray(x, jnp.float32) for x in values))
        count, half = len(query["radius"]), query["radius"] / 2
        place = query["place"] + half[:, None] * np.random.default_rng(seed).standard_normal((count, 2))
        local: Any = [np.asarray(x, np.float32) for x in (place, 3**0.5 * half, query["toward"], query["light"])]
        queries = LocalQuery(*local)
        padded = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[:1], -count % BATCH, axis=0)]), queries)
        rgba = np.concatenate([_taught(layout, teacher, placement, part) for part in _parts(padded)])[:count]
        grazing = max(placing.curvature * float(teacher.depth) * (2 - placing.curvature * float(teacher.depth)), 0.0)
        columns = {"alpha": rgba[:, 3:], "cosine": np.full((count, 1), grazing**0.5), "reflectance": rgba[:, :3]}
        return columns, {"light": 0.0, "geometry": 0.0}

    return of


def _parts(queries: LocalQuery) -> list[LocalQuery]:
    rows = range(0, len(queries.radius), BATCH)
    return [jax.tree.map(lambda x, i=i: jnp.asarray(x[i : i + BATCH]), queries) for i in rows]


@partial(jax.jit, static_argnums=0)
def _taught(layout: Layout, teacher: Teacher, placement: DevicePlacement, queries: LocalQuery) -> Float[Array, "Q 4"]:
    field = neural_field(teacher.material, layout)
    return jax.vmap(lambda local: answer(field, teacher, placement, local))(queries)


def answer(field: Field, teacher: Teacher, placement: DevicePlacement, local: LocalQuery) -> Float[Array, "4"]:
    """L / E⊥ and α of one query, whose ray lies across the axis."""
    end, ends_on_body = span(placement.curvature, teacher.depth, local.toward[2])
    step = end / SAMPLES
    t = step * (jnp.arange(SAMPLES, dtype=jnp.float32) + 0.5)
    points, inverse, length = jax.vmap(lambda t: _point(teacher, placement, local, t, step))(t)
    sigma, features = jax.vmap(field.density)(points)
    view = jax.vmap(lambda a: normalise(product(a, local.toward)))(inverse)
    light = jax.vmap(lambda a: normalise(product(a, local.light)))(inverse)
    rho = jax.vmap(field.transport)(features, view, light)
    share, through = weights(optical_depth(sigma, length))
    rgb = product(share, rho)
    body = _body(field, teacher, placement, local, end)
    on_body = ends_on_body.astype(jnp.float32)
    return jnp.append(rgb + on_body * through * body, jnp.where(ends_on_body, 1.0, 1 - through))


def span(curvature: Scalar, depth: Scalar, cosine: Scalar) -> tuple[Scalar, Array]:
    """Distance at which a ray that enters with ω_z = cosine ends, and whether it ends on the body."""
    g = depth * (2 - curvature * depth)
    root = cosine * cosine - curvature * g
    met = root >= 0
    deep = g / (cosine + jnp.sqrt(jnp.where(met, root, 0.0)))
    return jnp.where(met, deep, 2 * cosine / jnp.where(met, 1.0, curvature)), met


def _point(
    teacher: Teacher, placement: DevicePlacement, local: LocalQuery, t: Scalar, step: Scalar
) -> tuple[Point, Array, Scalar]:
    """The shell's point at t, J⁻¹ there in the frame of the place where the ray enters, and the canonical length of a step."""
    where, inverse = frame(teacher.depth, placement, local.place, -t * local.toward)
    d = product(inverse, -local.toward)
    print_ = footprint(inverse, -local.toward, step * step / 12, local.radius**2)
    point = Point(where, jnp.maximum(print_.minor, 0.0), print_.height, teacher.alpha)
    return point, inverse, jnp.sqrt(product(d, d)) * step


def frame(
    depth: Scalar, placement: DevicePlacement, place: Float[Array, "2"], p: Vec3
) -> tuple[Vec3, Float[Array, "3 3"]]:
    """(u, v, h) of a point p, and J⁻¹ there. place: (s, y) of the frame's own origin."""
    k, x, y, z = placement.curvature, p[0], p[1], p[2]
    reach = jnp.sqrt((k * x) ** 2 + (1 + k * z) ** 2)
    height = (k * (x * x + z * z) + 2 * z) / (1 + reach)
    angle = jnp.arctan2(k * x, 1 + k * z)
    s = jnp.where(jnp.abs(k) > 1e-4, angle / jnp.where(jnp.abs(k) > 1e-4, k, 1.0), x / (1 + k * z))
    uv = product(placement.turn, place + jnp.stack([s, y])) + placement.shift
    c, n = (1 + k * z) / reach, k * x / reach
    zero, one = jnp.zeros_like(c), jnp.ones_like(c)
    across = jnp.stack([c, zero, -n]) / (1 + k * height)
    rows = product(placement.turn, jnp.stack([across, jnp.stack([zero, one, zero])]))
    inverse = jnp.concatenate([rows, jnp.stack([n, zero, c])[None] / depth])
    return jnp.concatenate([uv, jnp.clip(1 + height / depth, 0, 1)[None]]), inverse


def _body(field: Field, teacher: Teacher, placement: DevicePlacement, local: LocalQuery, end: Scalar) -> Vec3:
    """Reflectance of the base surface at the ray's end: diffuse, lit through a flat shell."""
    xi, inverse = frame(teacher.depth, placement, local.place, -end * local.toward)
    normal = normalise(inverse[2])
    light = normalise(product(inverse, local.light))
    up = jnp.maximum(light[2], FLATTEST)
    h = (jnp.arange(BASE_SAMPLES, dtype=jnp.float32) + 0.5) / BASE_SAMPLES

    def density(h: Scalar) -> Scalar:
        at = jnp.append(xi[:2] + h / up * light[:2], h)
        zero = jnp.zeros_like(h)
        return field.density(Point(at, local.radius, zero, teacher.alpha))[0]

    dimmed = jnp.where(light[2] > 0, jnp.exp(-jax.vmap(density)(h).mean() / up), 0.0)
    return teacher.base / jnp.pi * jnp.maximum(product(normal, local.light), 0) * dimmed
