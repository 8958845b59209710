"""A USD dome light as a latitude-longitude map that lies as ours do (no JAX).

Notation
d, d′       unit vector in the stage, and in the dome's own frame, whose pole is +y
turn        from the dome's frame to the stage's                                                                  (3, 3)
pixel       of d′, as OpenEXR defines such maps: longitude 0, the middle column, is +z; +x lies a quarter to the left of it

Blender writes no rotation for a sky without a mapping node, and one of 90 degrees about x and z for a mapping of zero, which
shows the same. Both are read so, of stages that say they are Blender's.

Sources: OpenUSD's documentation of UsdLuxDomeLight and UsdLuxDomeLight_1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.geometry.read_usd import pxr
from mesoshell.io.image import exr_image
from mesoshell.render.light import pixel_directions

#: The turn of a dome whose pole is z, and Blender's of a sky that is not turned.
POLE_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
BLENDERS = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


@dataclass(frozen=True, eq=False)
class Dome:
    """file: its image as the stage names it, where that is found, and its form; or None: it is the same everywhere; strength:
    intensity times colour; up: the stage's axis."""

    file: tuple[str, str, str] | None
    turn: Float[np.ndarray, "3 3"]
    strength: Float[np.ndarray, "3"]
    up: str

    def radiance(self) -> Float[np.ndarray, "H W 3"]:
        """The map. Raises InputError if its image cannot be read."""
        image = np.ones((2, 4, 3), np.float32) if self.file is None else _read(*self.file)
        height, width = image.shape[:2]
        d = pixel_directions(height, width, 1 if self.up == "y" else 2) @ self.turn
        column = ((0.5 - np.arctan2(d[..., 0], d[..., 2]) / (2 * np.pi)) % 1.0 * width).astype(int) % width
        row = np.clip((np.arccos(np.clip(d[..., 1], -1, 1)) / np.pi * height).astype(int), 0, height - 1)
        return image[row, column] * self.strength.astype(np.float32)


def dome_of(
    light: Any, to_world: Float[np.ndarray, "4 4"], strength: Float[np.ndarray, "3"], blenders: bool, up: str, time: Any
) -> Dome:
    """A dome light: it is turned, never moved or stretched. Raises ValueError for a number that none can have."""
    prim = light.GetPrim()
    if not np.isfinite(to_world).all() or not ((strength >= 0) & (strength < 1e30)).all():
        raise ValueError(f"{prim.GetPath()} holds a number that no light has")
    turn, stretch = np.linalg.qr(to_world[:3, :3])
    turn = turn * np.where(np.diag(stretch) < 0, -1.0, 1.0)[None]
    axis = prim.GetAttribute("poleAxis").Get() if prim.HasAttribute("poleAxis") else "Y"
    if axis == "Z" or (axis == "scene" and up == "z"):
        turn = turn @ POLE_Z
    elif blenders and np.allclose(turn, np.eye(3)):
        turn = BLENDERS
    image, form = light.GetTextureFileAttr().Get(time), light.GetTextureFormatAttr().Get(time)
    file = None if image is None or not image.path else (image.path, image.resolvedPath, form or "automatic")
    return Dome(file, turn, strength, up)


def _read(name: str, found: str, form: str) -> Float[np.ndarray, "H W 3"]:
    if form not in ("automatic", "latlong"):
        raise InputError(name, f"is of the form {form}; skies are read from latitude-longitude images")
    Ar = pxr("Ar")
    file = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(found)) if found else None
    if file is None:
        raise InputError(name, "no such file")
    image = exr_image(file.GetBuffer(), name)[..., :3]
    if not image.size or not (image.min() >= 0 and image.max() < np.inf):  # NaN is neither
        raise InputError(name, "holds no light, or negative or infinite light")
    return image
