"""The bundle: a material in one NAME.npz, or in a folder (standard library and NumPy only).

symbol   meaning                                                                   shape, unit
C        channels of the features
P, Q     corners of patches of a texture with edges, along v and u: ⌈H / texel_density⌉ + 1
H, W     texels of a feature level along v (axis 0) and u (axis 1)                 any; wrapping: powers of two
R        rows of a height feature level along h; clamped at both ends              any R0 ≥ 1
L        feature levels
B        rows of the correction along h, clamped at both ends                      any B ≥ 1
E        height encoding h, sin(π 2ᵏ h) …, cos(π 2ᵏ h) …, k < height_octaves       E = 1 + 2 · height_octaves
A        number of α parameters
T, S     widths of the trunk's and the head's layers; T without a number: the last trunk layer, S: the last head layer
any      cells of a σ grid along h, v, u; a cell holds the largest σ in it         1 / canonical length

A zip file of `.npy` members, what numpy.savez_compressed writes: member KEY.npy holds array KEY. To read one:

    with np.load("grass.npz", allow_pickle=False) as file:
        manifest = json.loads(file["manifest.json"].tobytes())
        arrays = {key: file[key] for key in file.files if key != "manifest.json"}

A folder holds the same: KEY.npy, and manifest.json as plain text. Its arrays are mapped, not read. Levels may share a file, one
after the other: NAME.npy holds all numbers of NAME/0, NAME/1, …, and NAME.json the list of their shapes.

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

Arrays: the table `SHELL` (io/bundle_arrays); i counts 0, 1, 2, … without a gap and j = i + 1. Without a generator, features,
height and grid are required; with one they are all there or all missing, and generator/… holds its weights, whose shapes follow
from its configuration (`shell/generator/model` checks them). heights is there if geometry varies over the texture: F(h) at the
corners of its patches, bilinear between them; height is then their mean. correction is there if averaged features are
corrected: what is added to F(u, v) + F(h) at each level and height, linear between them. twin/… holds the arrays of the
distilled surface material.

A texture of corner tiles wraps, and has 4 patches along each side; of more than a patch, its levels hold the mean.

A feature level has half the texels of the one before along each axis: of a texture that wraps max(1, n // 2), down to 1; of one
with edges ⌈n / 2⌉, until a texel is a patch (texel_density is then a power of two). There is a grid for each level: its cells
span what wraps, or are min(8, texels a patch) a patch. Layers are y = x · kernel + bias, hidden ones (trunk, head; one or more)
followed by ReLU. The trunk sees F(u, v) + F(h), with its correction, the encoded h and α (manifest order, mapped from its range
to [0, 1]); σ = sigma_scale · softplus(x − 3), x from its last layer. The head sees that layer, ω and ω′ (3 numbers each).

Reading takes nothing on trust: shapes and types are checked before data are unpacked, memory follows the bytes that are
there and not the sizes they claim, NaN and infinity are refused. Writing checks the same; equal bundles, equal files.
"""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST, read_arrays, read_heads, write_arrays
from mesoshell.io.bundle_arrays import check_heads, check_values
from mesoshell.io.corner_tiles import Colours, is_torus
from mesoshell.io.records import parse_json
from mesoshell.io.twin import PREFIX, Twin, checked_twin, twin_arrays, twin_manifest, twin_of

#: Of a texture without corner tiles, and with them.
SCHEMA, TILED_SCHEMA = 2, 3
#: Cells of the σ grid along a patch's side, at most one a texel, where the texture has edges.
GRID_CELLS = 8
#: How far below the horizon, as a cosine, light still counts a little: ρ falls to 0 there.
FADE = 0.1


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
    """A material as it is on disk; the fields are those of the manifest, `arrays` those of io/bundle_arrays.SHELL."""

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

    @property
    def latent_size(self) -> int:
        """Numbers of the generator's latent z; 0 without one."""
        return 0 if self.generator is None else self.generator.get("z", 64)

    @property
    def extent(self) -> tuple[float, float]:
        """Patches (V, U) that the texture of a baked bundle covers."""
        height, width = self.arrays["features/0"].shape[:2]
        return height / self.texel_density, width / self.texel_density

    @property
    def finest_corrected(self) -> bool:
        """Whether features are corrected at level 0 too: of a texture whose finer levels are left out."""
        return "correction" in self.arrays and bool(self.arrays["correction"][0].any())


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
    """Read and check a bundle; its arrays are new and writable, or of a folder mapped and read-only. Raises InputError, one
    line, on any fault."""
    heads = read_heads(path)
    if MANIFEST not in heads or heads.pop(MANIFEST)[1] != np.uint8:
        raise InputError(path, f"has no {MANIFEST} of type uint8: not a bundle")
    fields = _parsed(path, read_arrays(path, [MANIFEST])[MANIFEST].tobytes())
    check_heads(path, fields, heads)
    arrays = read_arrays(path, heads)
    check_values(path, arrays)
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
    check_heads(path, fields, {key: (array.shape, array.dtype) for key, array in arrays.items()})
    check_values(path, arrays)
    return text


def _all_arrays(bundle: Bundle) -> dict[str, np.ndarray]:
    return bundle.arrays | ({} if bundle.twin is None else twin_arrays(bundle.twin))


def _parsed(path: str | PathLike[str], text: bytes) -> dict[str, Any]:
    """The manifest as the fields of a Bundle, without its arrays."""
    fields = parse_json(path, text, f"{MANIFEST} is ")
    if isinstance(fields, dict):
        fields.setdefault("twin", None)
        if fields.get("schema") == SCHEMA:
            fields.setdefault("tiles", None)
    _check_entry(path, MANIFEST, fields, _MANIFEST_RULES)
    if fields["tiles"] is not None:
        fields["tiles"] = tuple(tuple(row) for row in fields["tiles"])
    if fields["tiles"] is not None and not (fields["wraps"] and fields["generator"] is None):
        raise InputError(path, f"{MANIFEST}: corner tiles need a texture that wraps, without a generator")
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
