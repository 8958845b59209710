"""Load materials, and read the values given for their parameters (no JAX)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, Parameter, read_bundle, write_bundle
from mesoshell.io.image import read_picture
from mesoshell.io.material import PARAMS, check_name, find
from mesoshell.io.surface import KIND, SurfaceBundle, kind_of, read_surface, write_surface
from mesoshell.kept import constant

#: A grey image, as a file or (H, W) in [0, 1].
Image = str | PathLike[str] | Float[np.ndarray, "_ _"]
#: A parameter's value: a number in its unit; or an image of it, black to white over its range.
Value = float | Image


@dataclass(frozen=True, eq=False)
class Material:
    """A material: a neural shell, or a surface material. name: what it was loaded by; bundle: all that its file holds."""

    name: str
    bundle: Bundle | SurfaceBundle = field(repr=False)

    @property
    def kind(self) -> str:
        """As in its file: "shell", or "silhouette", which is a surface material."""
        return KIND if isinstance(self.bundle, SurfaceBundle) else "shell"

    @property
    def parameters(self) -> dict[str, Parameter]:
        """By name: range, default, unit and meaning, and role: "alpha" changes appearance, "beta" geometry. A surface material
        has none."""
        return {} if self.kind == KIND else {p.name: p for p in self.shell.parameters}

    @property
    def provenance(self) -> dict[str, Any]:
        """Its origin, as its file records it."""
        return self.bundle.provenance

    @property
    def shell(self) -> Bundle:
        """The bundle of a neural shell. Raises InputError for a surface material."""
        if isinstance(self.bundle, SurfaceBundle):
            raise InputError(self.name, f"its kind is '{KIND}'; expected 'shell'")
        return self.bundle

    @property
    def surface(self) -> SurfaceBundle:
        """The bundle of a surface material. Raises InputError for a neural shell."""
        if isinstance(self.bundle, Bundle):
            raise InputError(self.name, f"its kind is 'shell'; expected '{KIND}'")
        return self.bundle

    def save(self, path: str | PathLike[str]) -> None:
        """Write it as one .npz file. Raises InputError if it cannot be written."""
        if isinstance(self.bundle, SurfaceBundle):
            write_surface(path, self.bundle)
        else:
            write_bundle(path, self.bundle)


def load_material(name: str | PathLike[str]) -> Material:
    """A bundled material by its name, or a .npz file, or the folder of a large texture. Raises InputError if it is none of
    these, or damaged."""
    path = find(str(name))
    return Material(str(name), constant(read_surface(path) if kind_of(path) == KIND else read_bundle(path)))


def read_params(bundle: Bundle, params: Mapping[str, Value]) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """The values that are numbers, in the parameters' units, and those that are grey images (H, W) in [0, 1], by name.

    Raises InputError for a name that the material does not have, or what is neither a number nor such an image."""
    numbers, images = {}, {}
    for name, value in params.items():
        check_name(bundle, name)
        number = _number(value)
        if number is None:
            images[name] = _image(name, value)
        else:
            numbers[name] = number
    return numbers, images


def _number(value: Value) -> float | None:
    try:
        return None if isinstance(value, np.ndarray | PathLike) else float(value)
    except (TypeError, ValueError):
        return None


def _image(name: str, value: Value) -> Float[np.ndarray, "H W"]:
    if isinstance(value, np.ndarray):
        label, image = f"{name}, an image,", value.astype(np.float32)
    else:
        label = f"{name}={value}"
        if not isinstance(value, str | PathLike) or not isfile(value):
            raise InputError(PARAMS, f"{label} is neither a number nor an image file")
        image = read_picture(Path(str(value)))[..., :3].mean(axis=-1).astype(np.float32)
    if image.ndim != 2 or not image.size:
        raise InputError(PARAMS, f"{label} has shape {image.shape}; expected (H, W)")
    if not ((image >= 0) & (image <= 1)).all():
        raise InputError(PARAMS, f"{label} holds values outside 0 to 1")
    return image
