"""The bundle of a surface material: kind "silhouette", a NAME.npz like a shell's (standard library and NumPy only).

Notation
period       side of the square that the texture repeats; also a unit of length                              texture unit
N            texels along a period at the finest level, a power of two; level i has max(1, N / 2ⁱ), down to 1
C            channels
MODULE       opacity, offset or reflectance
I, O         inputs of a module: C + 4 (ω, κ); reflectance C + 7 (ω, ω′, κ); its outputs: 1, 1, 3

manifest.json, every field required, no other allowed:

    schema           2
    kind             "silhouette"
    texels           N
    channels         C
    opacity          "direct": sigmoid(x) is opacity; "cosine": c = sigmoid(x − 4), and opacity sigmoid((ω_z − c) / step);
                     "none": everything is opaque
    step             width of that step, a cosine                                                            > 0
    offset           u′ = u − offset · x · (ω_x, ω_y)                                                        periods
    sees_curvature   whether networks see κ (else 0 in its place)
    curvature        [lo, hi]: trained for; networks see (2κ − lo − hi) / (hi − lo)                          1 / period
    depth            of the material under the surface                                                       periods
    colour_space     "linear Rec. 709"
    provenance       an object; it may be empty

Arrays: MODULE/texture/i (N_i, N_i, C), half; MODULE/hidden/i/kernel and bias, followed by ReLU, and MODULE/last/kernel and
bias, float. ρ = softplus(y − 2) of reflectance's y. A level is looked up bilinearly, wrapping; between levels linearly.
"""

import dataclasses
import json
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST, Head, read_arrays, read_heads, write_arrays
from mesoshell.io.records import parse_json

SCHEMA, KIND = 2, "silhouette"
#: Inputs of each module besides its texture, and its outputs.
MODULES = {"opacity": (4, 1), "offset": (4, 1), "reflectance": (7, 3)}


@dataclass(frozen=True, eq=False)
class SurfaceBundle:
    """A surface material as it is on disk; the fields are those of the manifest."""

    texels: int
    channels: int
    opacity: str
    step: float
    offset: float
    sees_curvature: bool
    curvature: tuple[float, float]
    depth: float
    provenance: dict[str, Any]
    arrays: dict[str, np.ndarray]


def kind_of(path: str | PathLike[str]) -> str:
    """The kind of a bundle, "shell" or "silhouette". Raises InputError if the file is not a bundle."""
    return str(_manifest(path).get("kind"))


def read_surface(path: str | PathLike[str]) -> SurfaceBundle:
    """Read and check a bundle. Raises InputError, one line, on any fault."""
    fields = _manifest(path)
    fixed = {"schema": SCHEMA, "kind": KIND, "colour_space": "linear Rec. 709"}
    for name, value in fixed.items():
        if fields.pop(name, None) != value:
            raise InputError(path, f"{MANIFEST}: {name} is not {value!r}")
    fields = checked_fields(path, MANIFEST, fields)
    heads = read_heads(path)
    heads.pop(MANIFEST)
    check_heads(path, fields, heads)
    arrays = read_arrays(path, heads)
    for key, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(path, f"array {key} has NaN or infinite values")
    return SurfaceBundle(**fields, arrays=arrays)


def write_surface(path: str | PathLike[str], bundle: SurfaceBundle) -> None:
    """Write a bundle. Raises InputError if the file cannot be written."""
    fields = fields_of(bundle) | {"schema": SCHEMA, "kind": KIND, "colour_space": "linear Rec. 709"}
    text = np.frombuffer(json.dumps(fields, indent=1, sort_keys=True).encode(), np.uint8)
    write_arrays(path, {MANIFEST: text, **dict(sorted(bundle.arrays.items()))})


def fields_of(bundle: SurfaceBundle) -> dict[str, Any]:
    """The manifest's fields that describe the material."""
    return {f.name: getattr(bundle, f.name) for f in dataclasses.fields(bundle) if f.name != "arrays"}


def checked_fields(path: str | PathLike[str], where: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Check the manifest's fields and return those of a SurfaceBundle. Raises InputError."""
    names = {f.name for f in dataclasses.fields(SurfaceBundle)} - {"arrays"}
    if fields.keys() != names:
        raise InputError(path, f"{where}: its fields are not {', '.join(sorted(names))}")
    fault = _fault(fields)
    if fault:
        raise InputError(path, f"{where}: {fault}")
    return fields | {"curvature": tuple(fields["curvature"])}


def check_heads(path: str | PathLike[str], fields: dict[str, Any], heads: dict[str, Head], prefix: str = "") -> None:
    """Check names, shapes and types of the arrays, whose names begin with `prefix`. Raises InputError."""
    heads = {key.removeprefix(prefix): head for key, head in heads.items()}
    wanted = _shapes(fields, heads)
    for key in sorted(wanted.keys() ^ heads.keys()):
        raise InputError(
            path, f"array {prefix}{key} is missing" if key in wanted else f"unexpected array {prefix + key!r}"
        )
    for key, (shape, dtype) in heads.items():
        if shape != wanted[key] or dtype != (np.float16 if "/texture/" in key else np.float32):
            raise InputError(path, f"array {prefix}{key} is {dtype} of shape {shape}; expected shape {wanted[key]}")


def _manifest(path: str | PathLike[str]) -> dict[str, Any]:
    heads = read_heads(path)
    if MANIFEST not in heads or heads[MANIFEST][1] != np.uint8:
        raise InputError(path, f"has no {MANIFEST} of type uint8: not a bundle")
    fields = parse_json(path, read_arrays(path, [MANIFEST])[MANIFEST].tobytes(), f"{MANIFEST} is ")
    if not isinstance(fields, dict):
        raise InputError(path, f"{MANIFEST} is not a JSON object")
    return fields


def _fault(fields: dict[str, Any]) -> str | None:
    def number(x: Any) -> bool:
        return type(x) in (int, float) and abs(x) < 1e9

    texels, curvature = fields["texels"], fields["curvature"]
    tests = {
        "texels": type(texels) is int and texels >= 1 and not texels & (texels - 1),
        "channels": type(fields["channels"]) is int and fields["channels"] >= 1,
        "opacity": fields["opacity"] in ("direct", "cosine", "none"),
        "step": number(fields["step"]) and fields["step"] > 0,
        "offset": number(fields["offset"]),
        "sees_curvature": type(fields["sees_curvature"]) is bool,
        "curvature": isinstance(curvature, list | tuple)
        and len(curvature) == 2
        and all(map(number, curvature))
        and curvature[0] < curvature[1],
        "depth": number(fields["depth"]) and fields["depth"] > 0,
        "provenance": isinstance(fields["provenance"], dict),
    }
    return next((f"{name} is {fields[name]!r}" for name, good in tests.items() if not good), None)


def _shapes(fields: dict[str, Any], heads: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """The required shape of each array; hidden layers may have any width."""
    wanted = {}
    for module, (inputs, out) in MODULES.items():
        for i in range(fields["texels"].bit_length()):
            n = fields["texels"] >> i
            wanted[f"{module}/texture/{i}"] = (n, n, fields["channels"])
        width, i = fields["channels"] + inputs, 0
        while f"{module}/hidden/{i}/kernel" in heads or i == 0:
            shape = heads.get(f"{module}/hidden/{i}/kernel", ((width, 1), None))[0]
            wide = max(1, shape[1]) if len(shape) == 2 else 1
            wanted[f"{module}/hidden/{i}/kernel"], wanted[f"{module}/hidden/{i}/bias"] = (width, wide), (wide,)
            width, i = wide, i + 1
        wanted[f"{module}/last/kernel"], wanted[f"{module}/last/bias"] = (width, out), (out,)
    return wanted
