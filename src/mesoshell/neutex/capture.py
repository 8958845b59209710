"""An object's photographs, ready for training: linear colours, masks, and the box that the object lies in.

Notation
x, y        a point of the capture's world, and of the box: y = (x − centre) / half; the object lies in [−1, 1]³
rgb         linear Rec. 709, premultiplied by the mask: black outside of the object
mask        share of a pixel that the object covers: by a mask file, the image's alpha, or its difference to `background`

The box is given by the capture, or else that of the visual hull (neutex/hull).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_dilation

from mesoshell.errors import InputError
from mesoshell.io.image import linear_to_srgb, read_picture
from mesoshell.io.poses import Posed, read_poses
from mesoshell.neutex.cameras import Photo, shrunk
from mesoshell.neutex.hull import Hull, agreement, carve, holds, left_out

#: Least difference from the background, in sRGB codes, of a pixel that the object covers fully.
APART = 0.06
#: Number of views, and share of masked pixels in agreement, below which a warning is given.
FEW, AGREED = 8, 0.9
#: Cells that a point may lie outside of the hull.
NOISE = 3
BACKGROUNDS = {"black": 0.0, "white": 1.0}


@dataclass(frozen=True)
class Capture:
    """hull: where the object may be, by the masks; its box is the default for the capture's. points: in the world, in the hull
    or within NOISE cells of it. agreement: of the masks, the mean over views. flash: E⊥ of the light at each camera, at world
    distance 1, if there is one."""

    folder: Path
    photos: tuple[Photo, ...]
    rgb: tuple[Float[np.ndarray, "_h _w 3"], ...]
    masks: tuple[Float[np.ndarray, "_h _w"], ...]
    centre: Float[np.ndarray, "3"]
    half: float
    hull: Hull
    points: Float[np.ndarray, "P 3"] | None
    agreement: float
    warnings: tuple[str, ...]
    flash: float | None = None
    background: str | None = None

    @property
    def manifest(self) -> dict[str, object]:
        """Entries for a run's record."""
        box = [float(f"{x:.5g}") for x in (*self.centre, self.half)]
        entries: dict[str, object] = {"source": f"{len(self.photos)} photographs", "box": box}
        entries["photographs"] = self.digest
        return entries | ({"background": self.background} if self.background else {})

    @cached_property
    def digest(self) -> str:
        """A hash of the photographs."""
        sha = hashlib.sha256()
        for image in self.rgb:
            sha.update(np.ascontiguousarray(image).data)
        return sha.hexdigest()[:16]

    @property
    def recipe(self) -> str:
        """Kind of the data, as experiments name it."""
        return "capture"

    def to_box(self, x: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        return (x - self.centre) / self.half


def read_capture(folder: Path, background: str | None = None, side: int | None = None) -> Capture:
    """Read a capture. background: a name of BACKGROUNDS, for images that have neither masks nor alpha. side: of the images at
    most, pixels; larger ones are shrunk as they are read. Raises InputError that names the file and the fault; `warnings` lists
    what can be used but looks wrong."""
    poses = read_poses(folder)
    if len(poses.views) < 2:
        raise InputError(poses.source, f"has {len(poses.views)} view: a shape needs at least 2")
    read = [_shrunk(*_read(poses.source, view, background), side) for view in poses.views]
    photos, masks = [photo for photo, _, _ in read], [mask for _, _, mask in read]
    _see(poses.source, [view.image for view in poses.views], masks, side)
    hull = carve(photos, masks)
    if hull is None:
        raise InputError(
            poses.source,
            "no point lies inside the masks of all views: wrong poses or lenses, or views of different things",
        )
    agreed = np.array([agreement(hull, photo, mask) for photo, mask in zip(photos, masks, strict=True)])
    warnings = [f"has only {len(photos)} views: the shape between them is a guess"] if len(photos) < FEW else []
    if agreed.mean() < AGREED:
        worst = poses.views[int(np.argmin(agreed))].image.name
        warnings.append(
            f"masks of different views agree on {agreed.mean():.0%} of what they show ({worst}: {agreed.min():.0%}): wrong "
            "poses, lenses or masks?"
        )
    centre, half = poses.box or (hull.centre, hull.half)
    if poses.box and (outside := left_out(hull, centre, half)) > 0.1:
        warnings.append(f"{outside:.0%} of what the masks show lies outside of the box that {poses.source.name} gives")
    points = None
    if poses.points is not None:
        # noisy points lie on both sides of a surface, which the hull's outermost cells contain
        inside = holds(hull._replace(inside=binary_dilation(hull.inside, iterations=NOISE)), poses.points)
        if inside.mean() < 0.5:
            warnings.append(
                f"{1 - inside.mean():.0%} of the points lie outside of what the masks show: they are left out"
            )
        points = poses.points[inside] if inside.any() else None
    rgb = tuple(image for _, image, _ in read)
    return Capture(
        folder,
        tuple(photos),
        rgb,
        tuple(masks),
        centre,
        half,
        hull,
        points,
        float(agreed.mean()),
        tuple(warnings),
        poses.flash,
        background,
    )


def at_most(capture: Capture, side: int) -> Capture:
    """The same with images of at most `side` pixels a side, by means over whole pixels."""
    views = zip(capture.photos, capture.rgb, capture.masks, strict=True)
    photos, rgb, masks = zip(*(_shrunk(*view, side) for view in views), strict=True)
    return replace(capture, photos=photos, rgb=rgb, masks=masks)


def _shrunk(
    photo: Photo, image: np.ndarray, mask: np.ndarray, side: int | None
) -> tuple[Photo, np.ndarray, np.ndarray]:
    factor = -(-max(photo.width, photo.height) // (side or max(photo.width, photo.height)))
    return shrunk(photo, factor), _means(image, factor), _means(mask, factor)


def _means(x: np.ndarray, n: int) -> np.ndarray:
    h, w = x.shape[0] // n, x.shape[1] // n
    return x[: h * n, : w * n].reshape(h, n, w, n, *x.shape[2:]).mean(axis=(1, 3))


def _read(source: Path, view: Posed, background: str | None) -> tuple[Photo, np.ndarray, np.ndarray]:
    image = read_picture(view.image)
    height, width = image.shape[:2]
    if view.size and view.size != (width, height):
        raise InputError(view.image, f"is {width} x {height}; {source.name} says {view.size[0]} x {view.size[1]}")
    lens = view.lens
    if lens is None:
        assert view.angle is not None
        f = width / 2 / np.tan(view.angle / 2)
        lens = f, f, width / 2, height / 2
    rgb = image[..., :3]
    if view.mask is not None:
        mask = read_picture(view.mask)
        if mask.shape[:2] != (height, width):
            raise InputError(view.mask, f"is {mask.shape[1]} x {mask.shape[0]}; its image is {width} x {height}")
        half = 0.5 if view.mask.suffix.lower() == ".exr" else 0.2  # linear; or 0.5 as a code
        mask = (mask[..., :3].mean(axis=-1) >= half).astype(np.float32)
        rgb = rgb * mask[..., None]
    elif image.shape[2] == 4 and (background is None or (image[..., 3] < 1).any()):
        mask = image[..., 3]
    elif background is not None:
        rgb, mask = _from_background(rgb, BACKGROUNDS[background])
    else:
        raise InputError(
            view.image,
            "has neither a mask nor alpha: if its background is black or white, give `mesoshell atlas train --background`",
        )
    if not (np.isfinite(rgb).all() and np.isfinite(mask).all()):
        raise InputError(view.image, "has pixels that are not finite")
    return Photo(view.to_world, lens, width, height), rgb.astype(np.float32), np.clip(mask, 0, 1).astype(np.float32)


def _from_background(rgb: np.ndarray, value: float) -> tuple[np.ndarray, np.ndarray]:
    mask = np.clip(np.abs(linear_to_srgb(rgb) - value).max(axis=-1) / APART, 0, 1)
    mask[mask < 0.5] = 0.0
    return np.maximum(rgb - value * (1 - mask[..., None]), 0) * (mask[..., None] > 0), mask


def _see(source: Path, names: Sequence[Path], masks: Sequence[np.ndarray], side: int | None) -> None:
    empty = [name.name for name, mask in zip(names, masks, strict=True) if not (mask >= 0.5).any()]
    if empty:
        all_of = "all masks are" if len(empty) == len(masks) else f"the mask of {empty[0]} is"
        raise InputError(
            source, f"{all_of} empty{f' at {side} pixels a side' if side else ''}: no pixel shows the object"
        )
    if all((mask >= 0.5).all() for mask in masks):
        raise InputError(
            source,
            "all masks are full: nothing tells the object from its background; if that is black or white, give --background",
        )
