"""The texture as an image, and the effect of an edited image on an object.

Notation
T           an object's texture, linear: the greatest of its colours over directions d, as the paper shows it; or, of
            reflectance, its albedo, roughness or specular (neutex/brdf), grey
d           from the photographs (VIEWS of them at most) in front of the surface F_uv⁻¹ there, as its look from elsewhere is
            unknown; along the normal if there are none
E, α        an edit: colours and coverage of an image of any layout
c′ = a + s c    the edited colour, for a colour c that a view sees at u:
multiply    s = E, a = 0
replace     s = min(1, E/T), a = E − s T: where E = T nothing changes; elsewhere view-dependent shading is kept, scaled by at
            most 1

Where α is below 1 the edit is mixed with s = 1, a = 0.
"""

from functools import cache, partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float as NumPyFloat

from mesoshell.errors import InputError
from mesoshell.io.image import read_picture
from mesoshell.nets.batches import run
from mesoshell.neutex.brdf import MIN_ROUGHNESS
from mesoshell.neutex.field import Field, FieldConfig, lobes, texture, to_surface, view_reflectance
from mesoshell.neutex.layout import LAYOUTS, Layout, checkerboard, directions, shape, side_of
from mesoshell.neutex.render import Paint
from mesoshell.neutex.store import NeuTexModel
from mesoshell.numerics import normalise

Edit = Literal["replace", "multiply"]
Part = Literal["colour", "roughness", "specular"]
VIEWS = 32
#: Least cosine at which a camera counts as in front of a surface.
BEFORE = 0.1
#: Least texture value as a divisor.
DARKEST = 1e-4
#: Of the checkerboard: squares along a face's side, and pixels.
SQUARES, BOARD = 6, 192


def texture_image(
    model: NeuTexModel, layout: Layout, side: int, part: Part = "colour"
) -> NumPyFloat[np.ndarray, "h w 3"]:
    """T, linear and not negative. part: any but colour needs reflectance."""
    u = directions(layout, side)
    some = np.linspace(0, len(model.photos) - 1, min(VIEWS, len(model.photos))).round().astype(int)
    eyes = np.stack([model.to_box(model.photos[i]).to_world[:3, 3] for i in some]).astype(np.float32)
    (image,) = run(lambda u, n: (_greatest(model.config, part, model.field, eyes, u),), u.reshape(-1, 3))
    return np.maximum(image, 0).reshape(u.shape)


@partial(jax.jit, static_argnums=(0, 1))
def _greatest(config: FieldConfig, part: Part, field: Field, eyes, u):
    def point(u):
        if config.colour == "reflectance":
            brdf = lobes(config, field, u)
            of = {
                "colour": brdf.albedo,
                "roughness": jnp.maximum(brdf.roughness, MIN_ROUGHNESS),
                "specular": brdf.specular,
            }
            return jnp.broadcast_to(of[part], 3)
        base, features = texture(config, field, u)
        y, n = _surface(field, u)
        toward = normalise(eyes - y[None])
        before = (jnp.sum(toward * n[None], axis=1) > BEFORE)[:, None]
        ways = jnp.where(before, toward, n[None])
        each = jax.vmap(lambda v: view_reflectance(config, field, features, -v))(ways)
        return base + jnp.max(jnp.where(before | ~before.any(), each, -jnp.inf), axis=0)

    return jax.lax.map(jax.vmap(point), u.reshape(-1, 1024, 3)).reshape(-1, 3)


def _surface(field: Field, u):
    """F_uv⁻¹(u), and its normal there, outward."""
    a = normalise(jnp.cross(u, jnp.eye(3, dtype=u.dtype)[jnp.argmin(jnp.abs(u))]))
    (y, along), (_, across) = (jax.jvp(lambda u: to_surface(field, u), (u,), (v,)) for v in (a, jnp.cross(u, a)))
    return y, normalise(jnp.cross(along, across))


@cache
def board_paint() -> Paint:
    """A checkerboard that replaces the object's colours."""
    board = checkerboard("cubemap", BOARD, SQUARES)
    image = np.concatenate([board, np.zeros_like(board)], axis=-1)
    image.flags.writeable = False
    return Paint("cubemap", image)


def read_edit(path: Path, layout: Layout | None) -> tuple[Layout, NumPyFloat[np.ndarray, "h w c"]]:
    """Read an image, and its layout: the given one, or the only one with its proportions. Raises InputError."""
    image = read_picture(path)
    return checked_edit(image, layout, path), image


def checked_edit(image: NumPyFloat[np.ndarray, "h w c"], layout: Layout | None, source: str | Path) -> Layout:
    """The layout of an image that edits: the given one, or the only one with its proportions. Raises InputError about the
    source."""
    if not np.isfinite(image).all():
        raise InputError(source, "has pixels that are not finite")
    if image.shape[2] == 4 and not (image[..., 3].min() >= 0 and image[..., 3].max() <= 1 + 1e-3):
        raise InputError(source, "has coverage (alpha) outside of 0 to 1")
    h, w = image.shape[:2]
    layouts: tuple[Layout, ...] = LAYOUTS if layout is None else (layout,)
    fit: list[Layout] = [name for name in layouts if side_of(name, h, w)]
    if not fit:
        sizes = " or ".join(f"{name} ({shape(name, 1)[1]}:{shape(name, 1)[0]})" for name in layouts)
        raise InputError(source, f"is {w} x {h} pixels, the proportions of no {sizes}")
    return fit[0]


def paint_of(model: NeuTexModel, layout: Layout, image: NumPyFloat[np.ndarray, "h w c"], edit: Edit) -> Paint:
    """The edit of an image. image: linear RGB, or premultiplied RGBA."""
    side = side_of(layout, *image.shape[:2])
    assert side
    return paint_over(None if edit == "multiply" else texture_image(model, layout, side), layout, image)


def paint_over(
    now: NumPyFloat[np.ndarray, "h w 3"] | None, layout: Layout, image: NumPyFloat[np.ndarray, "h w c"]
) -> Paint:
    """The edit of an image that replaces a texture, T; or multiplies it, if that is None."""
    alpha = image[..., 3:] if image.shape[2] == 4 else np.ones_like(image[..., :1])
    rgb = image[..., :3]  # α E
    if now is None:
        return Paint(layout, np.concatenate([np.zeros_like(rgb), rgb + (1 - alpha)], axis=-1))
    s = np.minimum(alpha, rgb / np.maximum(now, DARKEST))  # α s
    return Paint(layout, np.concatenate([rgb - s * now, s + (1 - alpha)], axis=-1))
