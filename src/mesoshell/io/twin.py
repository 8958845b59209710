"""A surface material that was distilled from a shell, kept in the shell's bundle (standard library and NumPy only).

Notation
radius       standard deviation of a footprint, patches of the shell, which are periods of the surface material
error        FLIP between pictures of such footprints by the surface material and by the march: their mean plus 1.96 standard
             errors (distill/error)
"""

from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.archive import Head
from mesoshell.io.surface import SurfaceBundle, check_heads, checked_fields, fields_of

#: Prefix of the arrays' names in the shell's bundle.
PREFIX = "twin/"


@dataclass(frozen=True, eq=False)
class Twin:
    """alpha, base: the shell's normalised parameters and the colour under it, as distilled; errors: (radius, error), in order
    of increasing radius."""

    surface: SurfaceBundle
    alpha: tuple[float, ...]
    base: tuple[float, float, float]
    errors: tuple[tuple[float, float], ...]


def twin_manifest(twin: Twin) -> dict[str, Any]:
    """The field `twin` of the shell's manifest."""
    return {"surface": fields_of(twin.surface), "alpha": twin.alpha, "base": twin.base, "errors": twin.errors}


def twin_arrays(twin: Twin) -> dict[str, np.ndarray]:
    """The twin's arrays by their keys in the shell's bundle."""
    return {PREFIX + key: array for key, array in twin.surface.arrays.items()}


def checked_twin(path: str | PathLike[str], where: str, field: Any) -> dict[str, Any]:
    """Check the manifest's field and return the fields of a Twin; arrays are not checked. Raises InputError."""
    if not isinstance(field, dict) or field.keys() != {"surface", "alpha", "base", "errors"}:
        raise InputError(path, f"{where}: twin must have the fields surface, alpha, base and errors")
    if not isinstance(field["surface"], dict):
        raise InputError(path, f"{where}: twin: surface is not an object")
    rows = field["errors"]
    good = {
        "alpha": _numbers(field["alpha"]),
        "base": _numbers(field["base"]) and len(field["base"]) == 3,
        "errors": isinstance(rows, list | tuple) and len(rows) > 0 and all(_numbers(r) and len(r) == 2 for r in rows),
    }
    for name, right in good.items():
        if not right:
            raise InputError(path, f"{where}: twin: {name} is {field[name]!r}")
    if any(a[0] >= b[0] for a, b in pairwise(rows)):
        raise InputError(path, f"{where}: twin: radii of its errors must increase")
    return {
        "surface": checked_fields(path, f"{where}: twin", field["surface"]),
        "alpha": tuple(map(float, field["alpha"])),
        "base": tuple(map(float, field["base"])),
        "errors": tuple((float(r), float(e)) for r, e in rows),
    }


def check_twin_heads(path: str | PathLike[str], fields: dict[str, Any], heads: dict[str, Head]) -> None:
    """Check the arrays of a checked field. Raises InputError."""
    check_heads(path, fields["surface"], heads, PREFIX)


def twin_of(fields: dict[str, Any], arrays: dict[str, np.ndarray]) -> Twin:
    """From a checked field and the bundle's arrays."""
    own = {key.removeprefix(PREFIX): array for key, array in arrays.items() if key.startswith(PREFIX)}
    surface = SurfaceBundle(**fields["surface"], arrays=own)
    return Twin(surface, fields["alpha"], fields["base"], fields["errors"])


def _numbers(x: Any) -> bool:
    return isinstance(x, list | tuple) and all(type(n) in (int, float) and 0 <= n < 1e9 for n in x)
