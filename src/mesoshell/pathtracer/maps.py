"""Textures of a scene that give a material's parameters, each over the mesh's UV.

Notation
u, v        texture coordinates of the material, patches; over `patches` they are the mesh's own UV
flipped     Mitsuba's v is 1 minus ours
node        a corner of patches: geometry is made there, and interpolated between (shell/generator/nodes)

Appearance is looked up at samples; geometry is read at nodes before a scene is compiled. Some nodes lie beyond the mesh's UV:
if that is within the unit square, they are clamped to its edge, and the image does not repeat there.
"""

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.errors import InputError

#: Textures that need more than a UV coordinate.
_ELSEWHERE = {"MeshAttribute": "mesh_attribute", "VolumeAdapter": "volume"}
#: Distance from the unit square's edges at which the edge of a texture without pixels is read.
_INSET = 1e-6


def check_map(name: str, texture: mi.Texture, source: str) -> None:
    """Raise InputError for a texture that is not a function of the mesh's UV."""
    kind = _ELSEWHERE.get(texture.class_name())
    if kind is not None:
        raise InputError(source, f"texture for '{name}': a {kind} is not over the mesh's UV: give a bitmap")


def look_up(texture: mi.Texture, u, v, flipped: bool):
    """One number in [0, 1] at (u, v) of the mesh."""
    where = dr.zeros(mi.SurfaceInteraction3f)
    where.uv = mi.Point2f(u, 1 - v if flipped else v)
    return dr.clip(texture.eval_1(where), 0, 1)


def field_of(
    name: str, texture: mi.Texture, patches: float, flipped: bool, uv: np.ndarray, source: str
) -> Callable[[np.ndarray], np.ndarray]:
    """The texture's values at (…, 2) coordinates (u, v) in patches, for a mesh with coordinates uv. Raises InputError if they
    cannot be read, or are not finite."""
    inset = np.array([0.5 / n if n > 1 else _INSET for n in texture.resolution()])
    within = bool(uv.min() >= 0 and uv.max() <= 1)

    def values(at: np.ndarray) -> np.ndarray:
        place = np.clip(at / patches, inset, 1 - inset) if within else at / patches
        u, v = (mi.Float(np.ascontiguousarray(place[..., k].ravel(), np.float32)) for k in (0, 1))
        try:
            numbers = np.array(look_up(texture, u, v, flipped) + dr.zeros(mi.Float, len(u))).reshape(at.shape[:-1])
        except RuntimeError as error:
            raise InputError(source, f"texture for '{name}': {' '.join(str(error).split())}") from error
        if not np.isfinite(numbers).all():
            raise InputError(source, f"texture for '{name}' holds NaN")
        return numbers

    return values
