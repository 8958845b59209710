"""The bundle: a material in one NAME.npz, or in a folder (standard library and NumPy only).

symbol   meaning                                                                   shape, unit
C        channels of the features
P, Q     corners of patches of a texture with edges, along v and u: ⌈H / texel_density⌉ + 1
H, W     texels of a feature level along v (axis 0) and u (axis 1)                 any; wrapping: powers of two
R        rows of a height feature level along h; clamped at both ends              any R0 ≥ 1
E        height encoding h, sin(π 2ᵏ h) …, cos(π 2ᵏ h) …, k < height_octaves       E = 1 + 2 · height_octaves
A        number of α parameters
T, S     widths of the trunk's and the head's layers; T without a number: the last trunk layer, S: the last head layer
any      cells of a σ grid along h, v, u; a cell holds the largest σ in it         1 / canonical length

A zip file of `.npy` members, what numpy.savez_compressed writes: member KEY.npy holds array KEY. To read one:

    with np.load("grass.npz", allow_pickle=False) as file:
        manifest = json.loads(file["manifest.json"].tobytes())
        arrays = {key: file[key] for key in file.files if key != "manifest.json"}

A folder holds the same: KEY.npy, and manifest.json as plain text. Its arrays are mapped, not read.

manifest.json (a uint8 array: UTF-8 text of one JSON object), every field required, no other allowed:

    schema         2, or 3 of corner tiles
    kind           "shell"
    texel_density  texels a patch at level 0                                        > 0
    channels       C                                                                integer ≥ 1
    height_octaves sines (and cosines) that encode h                                integer ≥ 0
    parameters     list of {name, role, range: [lo, hi], default, unit, meaning}    role "alpha" or "beta", lo < hi
    thickness      height of the unit box over the side of a patch: 1 is a cube     > 0, patches; default proportions of a shell
    wraps          whether the texture is one patch that repeats, or has edges      true or false
    tiles          null, or 4 rows of 4 colours: the texture is a torus of corner tiles (io/corner_tiles); missing in schema 2
    generator      null, or the configuration of the generator whose weights these are   numbers and text
    twin           null, or of a surface material that was distilled from this (io/twin); it may be missing
    colour_space   "linear Rec. 709"
    provenance     an object about the origin: config, dataset, commit, metrics     free; it may be empty

Arrays: the table `SHELL` below; i counts 0, 1, 2, … without a gap and j = i + 1. Without a generator, features, height and
grid are required; with one they are all there or all missing, and generator/… holds its weights, whose shapes follow from its
configuration (`shell/generator/model` checks them). heights is there if geometry varies over the texture: F(h) at the corners
of its patches, bilinear between them; height is then their mean. twin/… holds the arrays of the distilled surface material.

A texture of corner tiles wraps, and has 4 patches along each side; of more than a patch, its levels hold the mean.

A feature level has half the texels of the one before along each axis: of a texture that wraps max(1, n // 2), down to 1; of one
with edges ⌈n / 2⌉, until a texel is a patch (texel_density is then a power of two). There is a grid for each level: its cells
span what wraps, or are min(8, texels a patch) a patch. Layers are y = x · kernel + bias, hidden ones (trunk, head; one or more)
followed by ReLU. The trunk sees F(u, v) + F(h), the encoded h and α (manifest order, mapped from its range to [0, 1]);
σ = sigma_scale · softplus(x − 3), x from its last layer. The head sees that layer, ω and ω′ (3 numbers each).

Reading takes nothing on trust: shapes and types are checked before data are unpacked, memory follows the bytes that are
there and not the sizes they claim, NaN and infinity are refused. Writing checks the same; equal bundles, equal files.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.archive import Head, read_arrays, read_heads, write_arrays
from mesoshell.io.corner_tiles import SIDE, Colours, is_torus
from mesoshell.io.records import parsed
from mesoshell.io.twin import PREFIX, Twin, check_twin_heads, checked_twin, twin_arrays, twin_manifest, twin_of

#: Of a texture without corner tiles, and with them.
SCHEMA, TILED_SCHEMA = 2, 3
MANIFEST = "manifest.json"
#: Cells of the σ grid along a patch's side, at most one a texel, where the texture has edges.
GRID_CELLS = 8
#: How far below the horizon, as a cosine, light still counts a little: ρ falls to 0 there.
FADE = 0.1
_EITHER = ("float16", "float32")

#: key: (shape in the symbols above, types)
SHELL: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "features/{i}": (("H{i}", "W{i}", "C"), _EITHER),
    "height/{i}": (("R{i}", "C"), _EITHER),
    "heights/{i}": (("P", "Q", "R{i}", "C"), _EITHER),
    "decoder/trunk/{i}/kernel": (("T{i}", "T{j}"), _EITHER),  # T0 = C + E + A
    "decoder/trunk/{i}/bias": (("T{j}",), _EITHER),
    "decoder/sigma/kernel": (("T", "1"), _EITHER),
    "decoder/sigma/bias": (("1",), _EITHER),
    "decoder/head/{i}/kernel": (("S{i}", "S{j}"), _EITHER),  # S0 = T + 6
    "decoder/head/{i}/bias": (("S{j}",), _EITHER),
    "decoder/rho/kernel": (("S", "3"), _EITHER),
    "decoder/rho/bias": (("3",), _EITHER),
    "sigma_scale": ((), ("float32",)),
    "grid/{i}": (("any", "any", "any"), _EITHER),
}

#: What is there if the texture is baked.
_BAKED = ("features/", "height/", "heights/", "grid/")
_NON_NEGATIVE = ("sigma_scale", "grid/")
#: Numbers that are looked at at a time: a folder's arrays may be larger than memory.
_BLOCK = 2**24


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
    wraps: bool = True
    tiles: Colours | None = None
    generator: dict[str, Any] | None = None
    twin: Twin | None = None

    @property
    def baked(self) -> bool:
        return "features/0" in self.arrays


def _is_number(x: Any) -> bool:
    return type(x) in (int, float) and -1e300 < x < 1e300


def _is_range(x: Any) -> bool:
    return isinstance(x, list) and len(x) == 2 and all(map(_is_number, x)) and x[0] < x[1]


#: field: (what it must be, the test), in the order of looking
Rules = dict[str, tuple[str, Callable[[Any], bool]]]
_MANIFEST_RULES: Rules = {
    "schema": (f"{SCHEMA} or {TILED_SCHEMA}", lambda x: x in (SCHEMA, TILED_SCHEMA)),
    "kind": ("'shell'", lambda x: x == "shell"),
    "texel_density": ("a number above 0", lambda x: _is_number(x) and x > 0),
    "channels": ("an integer, 1 or more", lambda x: type(x) is int and x >= 1),
    "height_octaves": ("an integer, 0 or more", lambda x: type(x) is int and x >= 0),
    "parameters": ("a list", lambda x: isinstance(x, list)),
    "thickness": ("a number above 0", lambda x: _is_number(x) and x > 0),
    "colour_space": ("'linear Rec. 709'", lambda x: x == "linear Rec. 709"),
    "provenance": ("an object", lambda x: isinstance(x, dict)),
    "wraps": ("true or false", lambda x: type(x) is bool),
    "tiles": ("null or the colours of a torus of 4 x 4 tiles", lambda x: x is None or is_torus(x)),
    "generator": ("null or an object", lambda x: x is None or isinstance(x, dict)),
    "twin": ("null or an object", lambda x: x is None or isinstance(x, dict)),
}
_PARAMETER_RULES: Rules = {
    "name": ("text", lambda x: isinstance(x, str)),
    "role": ("'alpha' or 'beta'", lambda x: x in ("alpha", "beta")),
    "range": ("[lo, hi] with lo < hi", _is_range),
    "default": ("a number", _is_number),
    "unit": ("text", lambda x: isinstance(x, str)),
    "meaning": ("text", lambda x: isinstance(x, str)),
}


def read_bundle(path: str | PathLike[str]) -> Bundle:
    """Read and check a bundle; its arrays are new and writable. Raises InputError, one line, on any fault."""
    heads = read_heads(path)
    if MANIFEST not in heads or heads.pop(MANIFEST)[1] != np.uint8:
        raise InputError(path, f"has no {MANIFEST} of type uint8: not a bundle")
    fields = _parsed(path, read_arrays(path, [MANIFEST])[MANIFEST].tobytes())
    _check_heads(path, fields, heads)
    arrays = read_arrays(path, heads)
    _check_values(path, arrays)
    if fields["twin"] is not None:
        fields["twin"] = twin_of(fields["twin"], arrays)
        arrays = {key: array for key, array in arrays.items() if not key.startswith(PREFIX)}
    return Bundle(**fields, arrays=arrays)


def write_bundle(path: str | PathLike[str], bundle: Bundle) -> None:
    """Check a bundle as reading does, then write it. Raises InputError; what was at `path` is then as it was."""
    text = checked_manifest(path, bundle)
    write_arrays(path, {MANIFEST: np.frombuffer(text, np.uint8)} | dict(sorted(_all_arrays(bundle).items())))


def checked_manifest(path: str | PathLike[str], bundle: Bundle) -> bytes:
    """The manifest's text, of a bundle that is checked as reading does."""
    manifest = {name: getattr(bundle, name) for name in _MANIFEST_RULES if name != "schema"}
    manifest["schema"] = SCHEMA if bundle.tiles is None else TILED_SCHEMA
    if bundle.tiles is None:
        del manifest["tiles"]
    manifest["twin"] = None if bundle.twin is None else twin_manifest(bundle.twin)
    manifest["parameters"] = [dataclasses.asdict(parameter) for parameter in bundle.parameters]
    try:
        text = json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(path, f"cannot be written: {MANIFEST} is not JSON: {error}") from error
    fields = _parsed(path, text)
    arrays = _all_arrays(bundle)
    _check_heads(path, fields, {key: (array.shape, array.dtype) for key, array in arrays.items()})
    _check_values(path, arrays)
    return text


def _all_arrays(bundle: Bundle) -> dict[str, np.ndarray]:
    return bundle.arrays | ({} if bundle.twin is None else twin_arrays(bundle.twin))


def _parsed(path: str | PathLike[str], text: bytes) -> dict[str, Any]:
    """The manifest as the fields of a Bundle, without its arrays."""
    fields = parsed(path, text, f"{MANIFEST} is ")
    if isinstance(fields, dict):
        fields.setdefault("twin", None)
        if fields.get("schema") == SCHEMA:
            fields.setdefault("tiles", None)
    _check_entry(path, MANIFEST, fields, _MANIFEST_RULES)
    if fields["tiles"] is not None:
        fields["tiles"] = tuple(tuple(row) for row in fields["tiles"])
    if fields["tiles"] is not None and not (fields["wraps"] and fields["generator"] is fields["twin"] is None):
        raise InputError(path, f"{MANIFEST}: corner tiles need a texture that wraps, without a generator and a twin")
    if (fields["schema"] == SCHEMA) != (fields["tiles"] is None):
        raise InputError(path, f"{MANIFEST}: schema {TILED_SCHEMA} is of corner tiles, and they are of it alone")
    if fields["twin"] is not None:
        fields["twin"] = checked_twin(path, MANIFEST, fields["twin"])
    for i, entry in enumerate(fields["parameters"]):
        where = f"{MANIFEST}: parameter {i}"
        _check_entry(path, where, entry, _PARAMETER_RULES)
        lo, hi = entry["range"]
        if not lo <= entry["default"] <= hi:
            raise InputError(path, f"{where}: default {entry['default']} is outside its range {lo} to {hi}")
        entry |= {"range": (float(lo), float(hi)), "default": float(entry["default"])}
    names = [entry["name"] for entry in fields["parameters"]]
    if len(set(names)) < len(names):
        raise InputError(path, f"{MANIFEST}: two parameters of one name in {names!r}")
    alphas = sum(entry["role"] == "alpha" for entry in fields["parameters"])
    if fields["twin"] is not None and len(fields["twin"]["alpha"]) != alphas:
        raise InputError(path, f"{MANIFEST}: twin: alpha has {len(fields['twin']['alpha'])} numbers; expected {alphas}")
    fields |= {name: float(fields[name]) for name in ("texel_density", "thickness")}
    parameters = tuple(Parameter(**entry) for entry in fields["parameters"])
    return {name: fields[name] for name in _MANIFEST_RULES if name != "schema"} | {"parameters": parameters}


def _check_entry(path: str | PathLike[str], where: str, entry: Any, rules: Rules) -> None:
    if not isinstance(entry, dict):
        raise InputError(path, f"{where} is not a JSON object")
    for name, (expected, test) in rules.items():
        if name not in entry:
            raise InputError(path, f"{where}: field {name!r} is missing")
        if not test(entry[name]):
            raise InputError(path, f"{where}: {name} is {entry[name]!r}; expected {expected}")
    for name in sorted(entry.keys() - rules.keys()):
        raise InputError(path, f"{where}: unexpected field {name!r}")


def _sizes(fields: dict[str, Any], heads: dict[str, Head]) -> tuple[dict[str, int], dict[str, int]]:
    """(Size of each symbol, members of each family); a missing or empty axis counts 1: its fault shows later."""

    def axis(key: str, k: int) -> int:
        shape = heads[key][0] if key in heads else ()
        return max(1, shape[k]) if k < len(shape) else 1

    first = {"H": axis("features/0", 0), "W": axis("features/0", 1), "R": axis("height/0", 0)}
    texels = max(1, int(fields["texel_density"]))
    across = max(first["H"], first["W"]) if fields["wraps"] else texels
    levels = across.bit_length()
    rows = first["R"].bit_length()
    sizes = {}
    for letter, n in first.items():
        up = letter != "R" and not fields["wraps"]
        sizes |= {f"{letter}{i}": -(-n >> i) if up else max(1, n >> i) for i in range(max(levels, rows))}
    sizes |= {"C": fields["channels"], "1": 1, "3": 3}
    sizes |= {"P": -(-first["H"] // texels) + 1, "Q": -(-first["W"] // texels) + 1}
    counts = {"features": levels, "height": rows, "heights": rows if "heights/0" in heads else 0, "grid": levels}
    alpha = sum(parameter.role == "alpha" for parameter in fields["parameters"])
    width = fields["channels"] + 1 + 2 * fields["height_octaves"] + alpha
    for letter, family in (("T", "decoder/trunk"), ("S", "decoder/head")):
        i = 0
        while i == 0 or f"{family}/{i}/kernel" in heads:
            sizes[f"{letter}{i}"], width, i = width, axis(f"{family}/{i}/kernel", 1), i + 1
        sizes[f"{letter}{i}"] = sizes[letter] = width
        counts[family] = i
        width += 6
    return sizes, counts


def _check_heads(path: str | PathLike[str], fields: dict[str, Any], heads: dict[str, Head]) -> None:
    """The arrays against `SHELL`, in both directions, by name, shape and type."""
    if fields["twin"] is not None:
        check_twin_heads(path, fields["twin"], {key: head for key, head in heads.items() if key.startswith(PREFIX)})
        heads = {key: head for key, head in heads.items() if not key.startswith(PREFIX)}
    sizes, counts = _sizes(fields, heads)
    expected = {
        pattern.format(i=i, j=i + 1): ([symbol.format(i=i, j=i + 1) for symbol in symbols], types)
        for pattern, (symbols, types) in SHELL.items()
        for i in range(counts.get(pattern.partition("/{i}")[0], 1))
    }
    if fields["tiles"] is not None and "heights/0" in heads:
        raise InputError(path, "array heights/0: corner tiles have one height feature")
    made = fields["generator"] is not None
    if made and not any(key.startswith(_BAKED) for key in heads):
        expected = {key: entry for key, entry in expected.items() if not key.startswith(_BAKED)}
    weights = {key for key in heads if made and key.startswith("generator/")}
    for key in sorted(expected.keys() - heads.keys()):
        raise InputError(path, f"array {key} is missing")
    for key in sorted(heads.keys() - expected.keys() - weights):
        raise InputError(path, f"unexpected array {key!r}")
    for key in weights:
        if str(heads[key][1]) not in _EITHER:
            raise InputError(path, f"array {key} holds {heads[key][1]}; expected {' or '.join(_EITHER)}")
    for key, (symbols, types) in expected.items():
        shape, dtype = heads[key]
        sides = [sizes.get(symbol, "any") for symbol in symbols]
        if len(shape) != len(sides) or not all(n == m or (n and m == "any") for n, m in zip(shape, sides, strict=True)):
            raise InputError(path, f"array {key} has shape {_row(shape)}; expected {_row(symbols)} = {_row(sides)}")
        if str(dtype) not in types:
            raise InputError(path, f"array {key} holds {dtype}; expected {' or '.join(types)}")
    if "features/0" in expected:
        _check_texture(path, fields, heads["features/0"][0])


def _check_texture(path: str | PathLike[str], fields: dict[str, Any], shape: tuple[int, ...]) -> None:
    height, width, _ = shape
    density = fields["texel_density"]
    if fields["wraps"] and (height & (height - 1) or width & (width - 1)):
        raise InputError(path, f"features/0 is {height} × {width} texels; expected powers of two")
    if fields["tiles"] is not None and not (height == width == SIDE * density):
        wanted = f"{SIDE * density:g} × {SIDE * density:g}"
        raise InputError(path, f"features/0 of corner tiles is {height} × {width} texels; expected {wanted}")
    if not fields["wraps"] and (density != int(density) or int(density) & (int(density) - 1)):
        raise InputError(path, f"texel_density is {density:g}; expected a power of two where the texture has edges")


def _row(sides: Sequence[int | str]) -> str:
    return f"({', '.join(map(str, sides))})"


def _check_values(path: str | PathLike[str], arrays: dict[str, np.ndarray]) -> None:
    for key, array in arrays.items():
        rows = max(1, _BLOCK * max(1, len(array)) // max(1, array.size)) if array.ndim else 1
        for block in (array[i : i + rows] for i in range(0, len(array), rows)) if array.ndim else [array]:
            if not np.isfinite(block).all():
                raise InputError(path, f"array {key} has NaN or infinite values")
            if key.startswith(_NON_NEGATIVE) and block.min() < 0:
                raise InputError(path, f"array {key} has negative values")
