"""Queries of a mesostructure on curved patches, as they lie on disk (NumPy only).

A folder: manifest.json, samples.jsonl with a row a patch (index, file, sha256, curvature), and patches/NNNNNN.npy, float32
(Q, 16), a query a row:

column       meaning                                                                        unit
u, v         where the ray meets the bounding surface                                       periods
radius       standard deviation of the places about it whose mean the answer is             periods
wx wy wz     ω toward the viewer; x and y are the tangents along u and v, z is outward      unit vector
kappa        curvature of the patch along the ray, positive seen from outside               1 / period
lx ly lz     ω′ toward the light, in the same frame; it may lie below the horizon           unit vector
alpha        share of rays that meet the mesostructure                                      0 to 1
cosine       of rays in the plane of ω and the normal, those with a smaller ω_z meet none   0 to 1
r g b        radiance toward ω over the irradiance on the plane facing the light; of rays   1/sr, linear Rec. 709
             that meet nothing, 0
patch        number of the patch
"""

import json
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file

COLUMNS = ("u", "v", "radius", "wx", "wy", "wz", "kappa", "lx", "ly", "lz", "alpha", "cosine", "r", "g", "b", "patch")
PARTS = "patches"


@dataclass(frozen=True, eq=False)
class Patches:
    """A folder of queries; patches: mapped, in the order of their numbers."""

    folder: Path
    manifest: dict[str, Any]
    patches: tuple[Float32[np.ndarray, "Q 16"], ...]

    @property
    def recipe(self) -> str:
        """What they show: a procedure's name, or an image file."""
        return str(self.manifest["source"])


def read_patches(folder: str | PathLike[str]) -> Patches:
    """All patches that are there. Raises InputError for what is not such a folder, or not whole."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "no such folder")
    texts = [read_file(folder / name) for name in ("manifest.json", "samples.jsonl")]
    try:
        manifest = json.loads(texts[0])
        rows = [json.loads(line) for line in texts[1].decode().splitlines()]
        files = [folder / row["file"] for row in sorted(rows, key=lambda row: row["index"])]
        kind = manifest["kind"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(folder, "its manifest.json or samples.jsonl is none of a dataset's") from error
    if kind != "patches":
        raise InputError(folder, f"holds {kind}, no queries of patches: mesoshell dataset render-patches makes them")
    if not isinstance(manifest, dict) or not isinstance(manifest.get("source"), str):
        raise InputError(folder / "manifest.json", "does not say what the queries are of: source is missing")
    if not files:
        raise InputError(folder, "has no patches yet")
    return Patches(folder, manifest, tuple(_queries(path) for path in files))


def _queries(path: Path) -> np.ndarray:
    try:
        array = np.lib.format.open_memmap(path, mode="r")
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except Exception as error:  # as of shards
        raise InputError(path, "not a NumPy array, or a truncated one") from error
    if array.dtype != np.float32 or array.shape[1:] != (len(COLUMNS),):
        raise InputError(path, f"is not float32 (Q, {len(COLUMNS)})")
    return array
