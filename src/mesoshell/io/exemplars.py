"""Exemplars: feature textures under one decoder, of many patches in one NAME.npz, or of a fitted material (standard library and
NumPy only).

symbol   meaning                                                       shape
K        patches
features F(u, v) of each, half precision; wraps around, tiles do not    (K, H, W, C)
patches  along a side of a feature: 1, or those of a torus of corner tiles
height   F(h), of all                                                  (R, C)
beta     geometry parameters of each, mapped to [0, 1]                 (K, G)
decoder  as a bundle's arrays have it                                  decoder/…, sigma_scale

manifest.json (a uint8 array: UTF-8 text of one JSON object): kind "exemplars"; height_octaves; parameters and provenance as in
a bundle (io/bundle).
"""

import json
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST, read_arrays, read_heads, write_arrays
from mesoshell.io.bundle import Parameter, read_bundle
from mesoshell.io.corner_tiles import SIDE
from mesoshell.io.material import digest
from mesoshell.io.records import parse_json

_FIELDS = {"kind", "height_octaves", "parameters", "provenance"}


@dataclass(frozen=True, eq=False)
class Exemplars:
    """Fitted patches. decoder: the arrays of a bundle's decoder; parameters: of the dataset, α and β."""

    features: Float[np.ndarray, "K H W C"]
    height: Float[np.ndarray, "R C"]
    beta: Float[np.ndarray, "K G"]
    decoder: dict[str, np.ndarray]
    height_octaves: int
    parameters: tuple[Parameter, ...]
    provenance: dict[str, Any]
    path: Path = Path()
    digest: str = ""
    patches: int = 1

    @property
    def folder(self) -> Path:
        """Their path, under the name that run records use."""
        return self.path

    def check_periodic(self) -> None:
        """Raise InputError for tiles of a torus, none of which repeats by itself."""
        if self.patches == 1 and self.provenance.get("config", {}).get("tiles"):
            raise InputError(self.path, "holds corner tiles of an unfinished fit, not patches that repeat")

    @property
    def recipe(self) -> str:
        datasets = self.provenance.get("datasets") or [{}]
        return datasets[0].get("recipe", "")

    @property
    def manifest(self) -> dict[str, Any]:
        """Their entry in a run's record."""
        names = [p.name for p in self.parameters]
        return {"recipe": self.recipe, "parameters": names, "size": self.features.shape, "digest": self.digest}


def write_exemplars(path: str | PathLike[str], exemplars: Exemplars) -> None:
    """Write the file, whole or not at all. Raises InputError if it cannot be written."""
    manifest = {
        "kind": "exemplars",
        "height_octaves": exemplars.height_octaves,
        "parameters": [asdict(p) for p in exemplars.parameters],
        "provenance": exemplars.provenance,
    }
    arrays = {
        "features": exemplars.features.astype(np.float16),
        "height": exemplars.height.astype(np.float16),
        "beta": exemplars.beta.astype(np.float32),
    }
    text = np.frombuffer(json.dumps(manifest, indent=1, allow_nan=False).encode(), np.uint8)
    write_arrays(path, {MANIFEST: text} | arrays | exemplars.decoder)


def read_exemplars(path: str | PathLike[str]) -> Exemplars:
    """Read and check exemplars, or a fitted material as the only one. Raises InputError, one line, on any fault."""
    heads = read_heads(path)
    if "features/0" in heads:
        return _of_material(path)
    wanted = {"features": 4, "height": 2, "beta": 2, MANIFEST: 1, "sigma_scale": 0}
    for key, axes in wanted.items():
        if key not in heads or len(heads[key][0]) != axes:
            raise InputError(path, f"has no array {key} of {axes} axes: not exemplars")
    arrays = read_arrays(path, heads)
    manifest = parse_json(path, arrays.pop(MANIFEST).tobytes(), f"{MANIFEST} is ")
    if not isinstance(manifest, dict) or manifest.keys() != _FIELDS or manifest["kind"] != "exemplars":
        raise InputError(path, f"{MANIFEST} does not describe exemplars")
    try:
        parameters = tuple(Parameter(**p | {"range": tuple(p["range"])}) for p in manifest["parameters"])
    except (TypeError, KeyError) as error:
        raise InputError(path, f"{MANIFEST}: parameters: {error}") from None
    for key, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(path, f"array {key} has NaN or infinite values")
    features, height, beta = (arrays.pop(key) for key in ("features", "height", "beta"))
    patches, rows, columns, channels = features.shape
    if rows != columns or rows & (rows - 1) or len(beta) != patches or height.shape[1] != channels:
        raise InputError(
            path, f"features, height and beta do not match: {features.shape}, {height.shape}, {beta.shape}"
        )
    octaves, provenance = manifest["height_octaves"], manifest["provenance"]
    roles = [p.role for p in parameters]
    if beta.shape[1] != roles.count("beta") or type(octaves) is not int or not isinstance(provenance, dict):
        raise InputError(path, f"{MANIFEST}: parameters, height_octaves or provenance do not match its arrays")
    inputs, layers = channels + 1 + 2 * octaves + roles.count("alpha"), ("trunk/0", "head/0", "sigma", "rho")
    missing = [k for n in layers for k in (f"decoder/{n}/kernel", f"decoder/{n}/bias") if k not in arrays]
    if missing or len(arrays["decoder/trunk/0/kernel"]) != inputs:
        raise InputError(
            path, f"array {missing[0]} is missing" if missing else f"its decoder does not take {inputs} numbers"
        )
    return Exemplars(features, height, beta, arrays, octaves, parameters, provenance, Path(path), digest(Path(path)))


def _of_material(path: str | PathLike[str]) -> Exemplars:
    bundle = read_bundle(path)
    decoder, parameters = read_decoder(path)
    feature, height = bundle.arrays["features/0"], decoder.pop("height/0")
    side = SIDE if bundle.tiles else 1
    about = bundle.height_octaves, parameters, bundle.provenance, Path(path), digest(Path(path))
    return Exemplars(feature[None], height, np.zeros((1, 0), np.float32), decoder, *about, side)


def read_decoder(path: str | PathLike[str]) -> tuple[dict[str, np.ndarray], tuple[Parameter, ...]]:
    """Arrays of a bundle's or exemplars' decoder under a bundle's names, F(h) as height/0; and the decoder's appearance
    parameters. Raises InputError."""
    if "features" in read_heads(path):
        exemplars = read_exemplars(path)
        return exemplars.decoder | {"height/0": exemplars.height}, _appearance(exemplars.parameters)
    bundle = read_bundle(path)
    if "height/0" not in bundle.arrays:
        raise InputError(path, "has no height feature: give a material that was fitted")
    kept = {k: x for k, x in bundle.arrays.items() if k.startswith("decoder/") or k in ("sigma_scale", "height/0")}
    return kept, _appearance(bundle.parameters)


def _appearance(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    return tuple(p for p in parameters if p.role == "alpha")
