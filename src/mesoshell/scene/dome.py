"""A USD dome light as a latitude-longitude map that lies as ours do (no JAX).

Notation
d′, d       unit vector in the dome's frame, whose pole is +y, and in the stage's
turn        from d′ to d                                                                                          (3, 3)
FRAMES      the turn of a dome whose image lies as our maps do: its middle toward +x, its pole up
pixel       of d′, as OpenEXR defines such maps: longitude 0, the middle column, is +z; +x lies a quarter to the left of it

A turn about the pole moves columns; shares of a column are interpolated. For any other turn a pixel is the mean of the nearest
pixels at 2 × 2 places in it.

Blender leaves a sky without a mapping node unturned in the stage, and one with a mapping of zero turned as our maps lie, which
shows the same. Both are read so, of stages that say they are Blender's.

Sources: OpenUSD's documentation of UsdLuxDomeLight and UsdLuxDomeLight_1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.contained import bounded_memory, silent
from mesoshell.errors import InputError
from mesoshell.geometry.read_usd import pxr
from mesoshell.io.image import radiance_of
from mesoshell.limits import check_memory, memory

FRAMES = {
    "y": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    "z": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
}
#: The turn of a dome whose pole is z, as OpenUSD has it.
POLE_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
#: Radiance that no light has; rows of a map that are turned together, of 4096 pixels.
BRIGHTEST, ROWS = 1e30, 64


@dataclass(frozen=True, eq=False)
class Dome:
    """name: of its image in the stage, empty if there is none; found: the image's place; form: its projection; strength:
    intensity · 2^exposure · colour."""

    name: str
    found: str
    form: str
    turn: Float[np.ndarray, "3 3"]
    strength: Float[np.ndarray, "3"]

    def radiance(self, up: str) -> Float[np.ndarray, "H W 3"] | None:
        """The map, of a scene whose up axis is "y" or "z"; None if it is black. Raises InputError if its image cannot be read,
        or holds what is no light."""
        image = np.ones((1, 2, 3), np.float32) if not self.name else _read(self.name, self.found, self.form)
        with np.errstate(over="ignore", invalid="ignore"):
            image = image * self.strength.astype(np.float32)
        if not (image.size and image.min() >= 0 and image.max() <= BRIGHTEST):  # NaN is neither
            raise InputError(self.name, f"holds negative light, or more than {BRIGHTEST:g}")
        return _turned(image, FRAMES[up].T @ self.turn) if image.any() else None


def dome_of(
    light: Any, to_world: Float[np.ndarray, "4 4"], strength: Float[np.ndarray, "3"], blenders: bool, up: str, time: Any
) -> Dome:
    """A dome light: it is turned, never moved or stretched. strength, up: of the stage. Raises ValueError for a transform or a
    strength that none can have."""
    UsdGeom, prim = pxr("UsdGeom"), light.GetPrim()
    if not np.isfinite(to_world).all() or not ((strength >= 0) & (strength <= BRIGHTEST)).all():
        raise ValueError(f"{prim.GetPath()} holds a number that no light has")
    turn, stretch = np.linalg.qr(to_world[:3, :3])
    turn = turn * np.where(np.diag(stretch) < 0, -1.0, 1.0)[None]
    axis = prim.GetAttribute("poleAxis").Get() if prim.HasAttribute("poleAxis") else "Y"
    own = np.array(UsdGeom.Xformable(prim).GetLocalTransformation(time))
    if axis == "Z" or (axis == "scene" and up == "z"):
        turn = turn @ POLE_Z
    elif blenders and np.allclose(own, np.eye(4)):
        turn = turn @ FRAMES["z"]
    image, form = light.GetTextureFileAttr().Get(time), light.GetTextureFormatAttr().Get(time)
    name, found = ("", "") if image is None else (image.path, image.resolvedPath)
    return Dome(name, found, form or "automatic", turn, strength)


def _read(name: str, found: str, form: str) -> Float[np.ndarray, "H W 3"]:
    if form not in ("automatic", "latlong"):
        raise InputError(name, f"is of the form {form}; skies are read from latitude-longitude images")
    Ar, Tf = pxr("Ar"), pxr("Tf")
    try:
        with silent(), bounded_memory(memory() // 2):
            file = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(found)) if found else None
            data = None if file is None else file.GetBuffer() or b""
    except (Tf.ErrorException, MemoryError, OSError) as fault:
        raise InputError(name, "cannot be read") from fault
    if data is None:
        raise InputError(name, "no such file")
    return radiance_of(data, name)


def _turned(image: Float[np.ndarray, "H W 3"], turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "H W 3"]:
    """The map as one that lies as ours. turn: from its frame to ours, both with the pole +y."""
    height, width = image.shape[:2]
    check_memory("sky", f"a sky of {width} x {height} pixels", 64 * width * height)
    if np.allclose(turn[1], [0, 1, 0]) and np.linalg.det(turn) > 0:
        columns = np.arctan2(turn[0, 2], turn[2, 2]) / (2 * np.pi) * width
        whole = np.round(columns)
        if abs(columns - whole) < 1e-4:
            return np.roll(image, -int(whole), axis=1)
        first = int(np.floor(columns))
        share = np.float32(columns - first)
        return (1 - share) * np.roll(image, -first, axis=1) + share * np.roll(image, -first - 1, axis=1)
    out = np.empty_like(image)
    longitude = (0.5 - (np.arange(2 * width) + 0.5) / (2 * width)) * 2 * np.pi
    for begin in range(0, height, ROWS):
        end = min(begin + ROWS, height)
        latitude = (0.5 - (np.arange(2 * begin, 2 * end) + 0.5) / (2 * height)) * np.pi
        b, l = np.meshgrid(latitude, longitude, indexing="ij")
        x, y, z = np.moveaxis(
            np.stack([np.cos(b) * np.sin(l), np.sin(b), np.cos(b) * np.cos(l)], axis=-1) @ turn, -1, 0
        )
        row = np.clip(((0.5 - np.arcsin(np.clip(y, -1, 1)) / np.pi) * height).astype(int), 0, height - 1)
        column = ((0.5 - np.arctan2(x, z) / (2 * np.pi)) % 1.0 * width).astype(int) % width
        out[begin:end] = image[row, column].reshape(end - begin, 2, width, 2, 3).mean(axis=(1, 3))
    return out
