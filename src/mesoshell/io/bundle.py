"""The bundle: a material in one NAME.npz (standard library and NumPy only; floor 2).

symbol   meaning                                                                   shape, unit
C        channels of the features
H, W     texels of a feature level along v (axis 0) and u (axis 1); it wraps       H0 and W0 powers of two
R        rows of a height feature level along h; clamped at both ends              any R0 ≥ 1
E        height encoding h, sin(π 2ᵏ h) …, cos(π 2ᵏ h) …, k < height_octaves       E = 1 + 2 · height_octaves
A        number of α parameters
T, S     widths of the trunk's and the head's layers; T without a number: the last trunk layer, S: the last head layer
G        cells of the σ grid along h, v, u (any numbers)                           largest σ in the cell, 1 / canonical length

A zip file of `.npy` members, what numpy.savez_compressed writes: member KEY.npy holds array KEY. To read one:

    with np.load("grass.npz", allow_pickle=False) as file:
        manifest = json.loads(file["manifest.json"].tobytes())
        arrays = {key: file[key] for key in file.files if key != "manifest.json"}

manifest.json (a uint8 array: UTF-8 text of one JSON object), every field required, no other allowed:

    schema         1
    kind           "shell"
    texel_density  texels a patch at level 0                                        > 0
    channels       C                                                                integer ≥ 1
    height_octaves sines (and cosines) that encode h                                integer ≥ 0
    parameters     list of {name, role, range: [lo, hi], default, unit, meaning}    role "alpha" or "beta", lo < hi
    thickness      height of the unit box over the side of a patch: 1 is a cube     > 0, patches
    colour_space   "linear Rec. 709"
    provenance     an object about the origin: config, dataset, commit, metrics     free; it may be empty

Arrays: the table `SHELL` below. i counts 0, 1, 2, … without a gap and j = i + 1. Level i of a feature has half the texels
of the one before along each axis (max(1, n // 2)), down to 1; there are as many grids as feature levels, trunk and head
have one layer or more. Layers are y = x · kernel + bias, hidden ones followed by ReLU. The trunk sees F(u, v) + F(h),
the encoded h and α (manifest order, each mapped from its range to [0, 1]); σ = sigma_scale · softplus(x − 3) from its last
layer. The head sees that layer, ω and ω′ (3 numbers each).

Reading takes nothing on trust: shapes and types are checked before any data are unpacked, memory follows the bytes that
are there and not the sizes that they claim, NaN and infinity are refused. Writing makes the same checks first.
Equal bundles are equal files (fixed order and time stamps; the bytes may differ between versions of zlib).
"""

import contextlib
import dataclasses
import io
import json
import math
import os
import zipfile
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import InputError

SCHEMA = 1
KIND = "shell"
COLOUR_SPACE = "linear Rec. 709"
MANIFEST = "manifest.json"

_EITHER = ("float16", "float32")
_SINGLE = ("float32",)

#: key: (shape in the symbols above, types)
SHELL: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "features/{i}": (("H{i}", "W{i}", "C"), _EITHER),
    "height/{i}": (("R{i}", "C"), _EITHER),
    "decoder/trunk/{i}/kernel": (("T{i}", "T{j}"), _EITHER),  # T0 = C + E + A
    "decoder/trunk/{i}/bias": (("T{j}",), _EITHER),
    "decoder/sigma/kernel": (("T", "1"), _EITHER),
    "decoder/sigma/bias": (("1",), _EITHER),
    "decoder/head/{i}/kernel": (("S{i}", "S{j}"), _EITHER),  # S0 = T + 6
    "decoder/head/{i}/bias": (("S{j}",), _EITHER),
    "decoder/rho/kernel": (("S", "3"), _EITHER),
    "decoder/rho/bias": (("3",), _EITHER),
    "sigma_scale": ((), _SINGLE),
    "grid/{i}": (("any", "any", "any"), _EITHER),
}

_NON_NEGATIVE = ("sigma_scale", "grid/")

#: Shape and type of an array: what is checked before its data are unpacked.
Head = tuple[tuple[int, ...], np.dtype]


@dataclass(frozen=True)
class Parameter:
    """A named control. range and default in `unit`; networks see (value − lo) / (hi − lo)."""

    name: str
    role: str
    range: tuple[float, float]
    default: float
    unit: str
    meaning: str


@dataclass(frozen=True, eq=False)
class Bundle:
    """A material as it is on disk; the fields are those of the manifest, `arrays` those of `SHELL`."""

    kind: str
    texel_density: float
    channels: int
    height_octaves: int
    parameters: tuple[Parameter, ...]
    thickness: float
    colour_space: str
    provenance: dict[str, Any]
    arrays: dict[str, np.ndarray]


_FIELDS = ("schema", *(f.name for f in dataclasses.fields(Bundle) if f.name != "arrays"))


def read_bundle(path: str | PathLike[str]) -> Bundle:
    """Read and check a bundle; its arrays are new and writable. Raises InputError, one line, on any fault of the file."""
    with _unzipped(path) as file:
        members = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
        if len(members) < len(file.infolist()):
            raise InputError(path, "holds two arrays of one name")
        heads = {key: _head(path, file, info) for key, info in members.items()}
        if MANIFEST not in heads:
            raise InputError(path, f"has no {MANIFEST}: not a bundle")
        text = _unpacked(file, members.pop(MANIFEST))
    if heads.pop(MANIFEST) != ((text.size,), np.dtype(np.uint8)):
        raise InputError(path, f"{MANIFEST} is not a row of uint8")
    try:
        fields = _checked_fields(path, json.loads(text.tobytes().decode()))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(path, f"{MANIFEST} is not JSON: {error}") from error
    _check_heads(path, fields, heads)
    with _unzipped(path) as file:
        arrays = {key: _unpacked(file, info) for key, info in members.items()}
    _check_values(path, arrays)
    return Bundle(**fields, arrays=arrays)


def write_bundle(path: str | PathLike[str], bundle: Bundle) -> None:
    """Check a bundle as `read_bundle` does, write PATH.partial and rename it. Raises InputError, then PATH is as it was."""
    manifest = {"schema": SCHEMA} | {name: getattr(bundle, name) for name in _FIELDS[1:]}
    manifest["parameters"] = [dataclasses.asdict(parameter) for parameter in bundle.parameters]
    try:
        text = json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(path, f"cannot be written: its manifest is not JSON: {error}") from error
    fields = _checked_fields(path, json.loads(text))
    _check_heads(path, fields, {key: (array.shape, array.dtype) for key, array in bundle.arrays.items()})
    _check_values(path, bundle.arrays)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        _pack(file, MANIFEST, np.frombuffer(text.encode(), np.uint8))
        for key in sorted(bundle.arrays):
            _pack(file, key, bundle.arrays[key])
    _replace(path, stream.getvalue())


@contextlib.contextmanager
def _unzipped(path: str | PathLike[str]) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as file:
            yield file
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "no such file") from error
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from error
    except Exception as error:  # zipfile, zlib and NumPy's parser throw a dozen types, by the byte that is wrong
        raise InputError(path, "not a zip file, or a truncated or damaged one") from error


def _head(path: str | PathLike[str], file: zipfile.ZipFile, info: zipfile.ZipInfo) -> Head:
    with file.open(info) as stream:
        if stream.read(len(_NPY)) != _NPY:
            raise InputError(path, f"member {info.filename!r} is not an array (npy 1.0)")
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        if stream.tell() + math.prod(shape) * dtype.itemsize != info.file_size:
            raise InputError(path, f"member {info.filename!r} is not as long as its shape and type say")
    return shape, dtype


def _unpacked(file: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """The array, after the zip's checksum: NumPy allocates what a header claims, so the bytes are unpacked first."""
    data = file.read(info)
    if len(data) != info.file_size:
        raise zipfile.BadZipFile
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def _pack(file: zipfile.ZipFile, key: str, array: np.ndarray) -> None:
    member = io.BytesIO()
    np.lib.format.write_array(member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
    info = zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
    file.writestr(info, member.getvalue())


def _replace(path: str | PathLike[str], data: bytes) -> None:
    partial = Path(f"{os.fspath(path)}.partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        fault = "its folder does not exist" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(path, f"cannot be written: {fault}") from error


def _checked_fields(path: str | PathLike[str], manifest: Any) -> dict[str, Any]:
    """The manifest as the fields of a Bundle."""
    if not isinstance(manifest, dict):
        raise InputError(path, f"{MANIFEST} is not a JSON object")
    for name, known in (("schema", SCHEMA), ("kind", KIND), ("colour_space", COLOUR_SPACE)):
        if manifest.get(name, known) != known:
            raise InputError(path, f"{name} is {manifest[name]!r}; this version reads {known!r}")
    _check_names(path, MANIFEST, manifest, _FIELDS)
    fields = {name: manifest[name] for name in _FIELDS[1:]}
    for name, least in (("channels", 1), ("height_octaves", 0)):
        if type(fields[name]) is not int or fields[name] < least:
            raise InputError(path, f"{name} is {fields[name]!r}; expected an integer, {least} or more")
    for name in ("texel_density", "thickness"):
        if not _is_number(fields[name]) or fields[name] <= 0:
            raise InputError(path, f"{name} is {fields[name]!r}; expected a number above 0")
        fields[name] = float(fields[name])
    if not isinstance(fields["provenance"], dict):
        raise InputError(path, "provenance is not a JSON object")
    if not isinstance(fields["parameters"], list):
        raise InputError(path, "parameters is not a list")
    fields["parameters"] = tuple(_parameter(path, i, entry) for i, entry in enumerate(fields["parameters"]))
    names = [parameter.name for parameter in fields["parameters"]]
    if len(set(names)) < len(names):
        raise InputError(path, f"two parameters of one name: {', '.join(names)}")
    return fields


def _parameter(path: str | PathLike[str], index: int, entry: Any) -> Parameter:
    where = f"parameter {index}"
    if not isinstance(entry, dict):
        raise InputError(path, f"{where} is not a JSON object")
    _check_names(path, where, entry, [f.name for f in dataclasses.fields(Parameter)])
    for name in ("name", "unit", "meaning"):
        if not isinstance(entry[name], str):
            raise InputError(path, f"{where}: {name} is {entry[name]!r}; expected text")
    if entry["role"] not in ("alpha", "beta"):
        raise InputError(path, f"{where}: role is {entry['role']!r}; expected 'alpha' or 'beta'")
    bounds, default = entry["range"], entry["default"]
    if not (isinstance(bounds, list) and len(bounds) == 2 and all(map(_is_number, bounds)) and bounds[0] < bounds[1]):
        raise InputError(path, f"{where}: range is {bounds!r}; expected [lo, hi], lo < hi")
    if not (_is_number(default) and bounds[0] <= default <= bounds[1]):
        raise InputError(path, f"{where}: default {default!r} is not in its range {bounds!r}")
    return Parameter(**entry | {"range": (float(bounds[0]), float(bounds[1])), "default": float(default)})


def _check_names(path: str | PathLike[str], where: str, entry: dict[str, Any], names: Iterable[str]) -> None:
    for name in names:
        if name not in entry:
            raise InputError(path, f"{where}: field {name!r} is missing")
    for name in sorted(entry.keys() - set(names)):
        raise InputError(path, f"{where}: unexpected field {name!r}")


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and -1e300 < value < 1e300


def _sizes(fields: dict[str, Any], heads: dict[str, Head]) -> tuple[dict[str, int], dict[str, int]]:
    """(Every symbol's size, members of every numbered family). An absent or empty axis counts 1: its fault shows later."""

    def axis(key: str, k: int) -> int:
        shape = heads[key][0] if key in heads else ()
        return max(1, shape[k]) if k < len(shape) else 1

    halved = {"H": axis("features/0", 0), "W": axis("features/0", 1), "R": axis("height/0", 0)}
    levels, rows = max(halved["H"], halved["W"]).bit_length(), halved["R"].bit_length()
    sizes = {f"{letter}{i}": max(1, n >> i) for letter, n in halved.items() for i in range(max(levels, rows))}
    counts = {"features": levels, "height": rows, "grid": levels}
    alpha = sum(parameter.role == "alpha" for parameter in fields["parameters"])
    width = fields["channels"] + 1 + 2 * fields["height_octaves"] + alpha
    for letter, family in (("T", "decoder/trunk"), ("S", "decoder/head")):
        i = 0
        while i == 0 or f"{family}/{i}/kernel" in heads:
            sizes[f"{letter}{i}"] = width
            width = axis(f"{family}/{i}/kernel", 1)
            i += 1
        sizes[f"{letter}{i}"] = sizes[letter] = width
        counts[family] = i
        width += 6
    return sizes | {"C": fields["channels"], "1": 1, "3": 3}, counts


def _check_heads(path: str | PathLike[str], fields: dict[str, Any], heads: dict[str, Head]) -> None:
    """The arrays against `SHELL`, in both directions, by name, shape and type."""
    sizes, counts = _sizes(fields, heads)
    expected = {
        pattern.format(i=i, j=i + 1): (tuple(symbol.format(i=i, j=i + 1) for symbol in shape), types)
        for pattern, (shape, types) in SHELL.items()
        for i in range(counts.get(pattern.partition("/{i}")[0], 1))
    }
    for key in expected.keys() - heads.keys():
        raise InputError(path, f"array {min(expected.keys() - heads.keys())!r} is missing")
