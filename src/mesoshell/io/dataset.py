"""Reading of a dataset folder: manifest.json, samples.jsonl (a row a sample), and images/NAME.exr or, if it is packed,
shards/NAME.npy (NumPy only).

symbol           meaning                                                       shape, unit, frame
camera_to_world  rigid; the camera looks along −z, y up                        (4, 4), canonical (the unit box) / camera
fov              angle of view across the width                                radians
radius           distance of the camera from the box's centre                  patches
light            unit direction toward the light (ω′)                          (3,), canonical
irradiance       E⊥ on the plane that faces the light                          (3,), linear Rec. 709
size             (W, H) of the image                                           pixels
image            premultiplied linear RGBA, rows from the top                  (H, W, 4)

Rows may stand in any order (several processes append them) and be fewer than the manifest's `count` while a dataset is
being made: `read_dataset` sorts what is there, `check_dataset` reports what is not. Fields beyond these are free.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file

_MANIFEST = {"recipe": str, "version": object, "field_of_view": object, "parameters": dict, "radius_range": list}
_MANIFEST |= {"size": list, "samples_per_pixel": object, "seed": object, "count": int}
_PARAMETER = ("role", "range", "default", "unit", "meaning")

#: field of a row: (shape, what it must be, the test)
_NUMBERS: dict[str, tuple[tuple[int, ...], str, Callable[[np.ndarray], Any]]] = {
    "index": ((), "a whole number, 0 or more", lambda x: x >= 0 and x == np.floor(x)),
    "seed": ((), "a number", lambda x: True),
    "size": ((2,), "[W, H] in whole pixels", lambda x: ((x >= 1) & (x <= 2**16) & (x == np.floor(x))).all()),
    "camera_to_world": ((4, 4), "4 × 4 numbers that end in 0 0 0 1", lambda x: (x[3] == (0, 0, 0, 1)).all()),
    "fov": ((), "an angle between 0 and π", lambda x: 0 < x < math.pi),
    "radius": ((), "a number above 0", lambda x: x > 0),
    "light": ((3,), "a unit vector", lambda x: abs(np.linalg.norm(x) - 1) < 1e-4),
    "irradiance": ((3,), "three numbers, 0 or more", lambda x: (x >= 0).all()),
}


@dataclass(frozen=True, eq=False)
class Sample:
    """One image and how it was made. Parameters are in their units, not normalised.

    file is the image's path; or, where row is not None, that of the array (n, H, W, 4) whose row it is.
    """

    index: int
    file: Path
    row: int | None
    sha256: str
    parameters: dict[str, float]
    camera_to_world: Float64[np.ndarray, "4 4"]
    fov: float
    radius: float
    light: Float64[np.ndarray, "3"]
    irradiance: Float64[np.ndarray, "3"]
    size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset folder; samples by rising index, all of one size. rows: what samples.jsonl says of each index."""

    folder: Path
    recipe: str
    manifest: dict[str, Any]
    samples: tuple[Sample, ...]
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)


def read_dataset(folder: str | PathLike[str]) -> Dataset:
    """Manifest and rows, checked; no image is opened. Raises InputError that names the file, and the line, at fault."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    rows = {}
    for entry in entries(folder, manifest):
        if isinstance(entry, InputError):
            raise entry
        rows[int(entry["index"])] = entry
    if not rows:
        raise InputError(folder / "samples.jsonl", "has no samples")
    samples = tuple(sample_of(folder, row) for _, row in sorted(rows.items()))
    return Dataset(folder, manifest["recipe"], manifest, samples, rows)


def origin(dataset: Dataset) -> dict[str, Any]:
    """What a material says of the renders that it was made from."""
    kept = ("recipe", "version", "size", "samples_per_pixel", "seed", "fixed_parameters", "patch", "coverage_range")
    return {k: dataset.manifest[k] for k in kept if dataset.manifest.get(k) is not None} | {
        "images": len(dataset.samples)
    }


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a dataset's folder, checked field by field. Raises InputError."""
    if not folder.is_dir():
        raise InputError(folder, "no such folder")
    text = _text(path := folder / "manifest.json")
    try:
        manifest = json.loads(text)
    except (ValueError, RecursionError) as error:
        fault = f"line {getattr(error, 'lineno', 1)}: not JSON: {getattr(error, 'msg', error)}"
        raise InputError(path, fault) from error
    if not isinstance(manifest, dict):
        raise InputError(path, "is not a JSON object")
    for name, known in (("schema", 1), ("alpha", "premultiplied")):
        if manifest.get(name) != known:
            raise InputError(path, f"{name} is {manifest.get(name)!r}; expected {known!r}")
    for name, kind in _MANIFEST.items():
        if name not in manifest:
            raise InputError(path, f"field {name!r} is missing")
        if not isinstance(manifest[name], kind):
            raise InputError(path, f"{name} is {manifest[name]!r}; expected {kind.__name__}")
    for name, entry in manifest["parameters"].items():
        if not isinstance(entry, dict) or not entry.keys() >= set(_PARAMETER):
            raise InputError(path, f"parameter {name!r} must have {', '.join(_PARAMETER)}")
        ends = _array(entry["range"], (2,))
        if ends is None or not ends[0] < ends[1]:
            raise InputError(path, f"parameter {name!r}: range is {entry['range']!r}; expected [lo, hi] with lo < hi")
    return manifest


def entries(folder: Path, manifest: dict[str, Any]) -> Iterator[dict[str, Any] | InputError]:
    """Each row in turn, or its fault."""
    path = folder / "samples.jsonl"
    seen: set[Any] = set()
    for number, line in enumerate(_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            row, fault = {}, f"not JSON: {getattr(error, 'msg', error)}"
        else:
            fault = _row_fault(manifest, row)
        if not fault and row["index"] in seen:
            fault = f"index {row['index']} occurs twice"
        if not fault and _place(row) in seen:
            fault = f"file {row['file']} occurs twice"
        if fault:
            yield InputError(path, f"line {number}: {fault}")
        else:
            seen |= {row["index"], _place(row)}
            yield row


def _place(row: dict[str, Any]) -> tuple[str, int | None]:
    return row["file"], row.get("row")


def _row_fault(manifest: dict[str, Any], row: Any) -> str | None:
    if not isinstance(row, dict):
        return "is not a JSON object"
    for name in ("file", "sha256", "parameters", *_NUMBERS):
        if name not in row:
            return f"field {name!r} is missing"
    for name, (shape, expected, test) in _NUMBERS.items():
        x = _array(row[name], shape)
        if x is None or not test(x):
            return f"{name} is {row[name]!r}; expected {expected}"
    if row["size"] != manifest["size"]:
        return f"size is {row['size']!r}; the manifest says {manifest['size']!r}"
    for name, pattern, expected in (
        ("file", r"images/[^/]+", "images/NAME") if "row" not in row else ("file", r"shards/[^/]+", "shards/NAME"),
        ("sha256", "[0-9a-f]{64}", "64 hex digits"),
    ):
        if not isinstance(row[name], str) or not re.fullmatch(pattern, row[name]):
            return f"{name} is {row[name]!r}; expected {expected}"
    if "row" in row and not (type(row["row"]) is int and row["row"] >= 0):
        return f"row is {row['row']!r}; expected a whole number, 0 or more"
    if "instance" in row and not (type(row["instance"]) is int and row["instance"] >= 0):
        return f"instance is {row['instance']!r}; expected a whole number, 0 or more"
    if not isinstance(row["parameters"], dict) or row["parameters"].keys() != manifest["parameters"].keys():
        return f"parameters are {row['parameters']!r}; the manifest declares {sorted(manifest['parameters'])!r}"
    for name, value in row["parameters"].items():
        lo, hi = manifest["parameters"][name]["range"]
        if _array(value, ()) is None or not lo <= value <= hi:
            return f"parameter {name!r} is {value!r}; expected {lo} to {hi}"
    return None


def sample_of(folder: Path, row: dict[str, Any]) -> Sample:
    """A sample, of its row of samples.jsonl."""
    return Sample(
        index=int(row["index"]),
        file=folder / row["file"],
        row=row.get("row"),
        sha256=row["sha256"],
        parameters={name: float(value) for name, value in row["parameters"].items()},
        camera_to_world=np.asarray(row["camera_to_world"], np.float64),
        fov=float(row["fov"]),
        radius=float(row["radius"]),
        light=np.asarray(row["light"], np.float64),
        irradiance=np.asarray(row["irradiance"], np.float64),
        size=(int(row["size"][0]), int(row["size"][1])),
    )


def parameter_table(parameters: dict[str, Any], samples: Sequence[Sample], role: str) -> Float32[np.ndarray, "N P"]:
    """α or β of samples, mapped to [0, 1] by their ranges. parameters: of the manifest."""
    out = np.empty((len(samples), sum(entry["role"] == role for entry in parameters.values())), np.float32)
    names = [name for name, entry in parameters.items() if entry["role"] == role]
    for column, name in zip(out.T, names, strict=True):
        low, high = parameters[name]["range"]
        column[:] = (np.array([sample.parameters[name] for sample in samples]) - low) / (high - low)
    return out


def _array(value: Any, shape: tuple[int, ...]) -> np.ndarray | None:
    """`value` as finite float64 numbers of this shape, or None."""
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    fits = array.dtype.kind in "iuf" and array.shape == shape and np.isfinite(array).all()
    return array.astype(np.float64) if fits else None


def _text(path: Path) -> str:
    try:
        return read_file(path).decode()
    except UnicodeDecodeError as error:
        raise InputError(path, "is not UTF-8 text") from error
