"""Queries of a mesostructure on curved patches, on disk (NumPy only).

A folder: manifest.json, samples.jsonl with a row a patch (index, file, sha256, curvature), and patches/NNNNNN.npy, float32
(Q, 16), a query a row:

column       meaning                                                                        unit
u, v         where the ray meets the bounding surface                                       periods
radius       standard deviation of the footprint around it that the answer averages        periods
wx wy wz     ω toward the viewer; x and y are the tangents along u and v, z is outward      unit vector
kappa        curvature of the patch along the ray, positive seen from outside               1 / period
lx ly lz     ω′ toward the light, in the same frame; it may lie below the horizon           unit vector
alpha        share of rays that meet the mesostructure                                      0 to 1
cosine       rays in the plane of ω and the normal with a smaller ω_z meet nothing          0 to 1
r g b        radiance toward ω over the irradiance on the plane facing the light; 0 if the  1/sr, linear Rec. 709
             ray meets nothing
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
from mesoshell.limits import allow_files

COLUMNS = ("u", "v", "radius", "wx", "wy", "wz", "kappa", "lx", "ly", "lz", "alpha", "cosine", "r", "g", "b", "patch")
#: Columns of opacity and of reflectance.
ALPHA, RGB = COLUMNS.index("alpha"), slice(COLUMNS.index("r"), COLUMNS.index("b") + 1)
PARTS = "patches"


@dataclass(frozen=True, eq=False)
class Patches:
    """A folder of queries; patches: memory-mapped, in the order of their numbers."""

    folder: Path
    manifest: dict[str, Any]
    patches: tuple[Float32[np.ndarray, "Q 16"], ...]

    @property
    def recipe(self) -> str:
        """Their mesostructure: a procedure's name, or an image file."""
        return str(self.manifest["source"])


def read_patches(folder: str | PathLike[str]) -> Patches:
    """Read all patches of a folder. Raises InputError if it holds no queries, or damaged ones."""
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
        raise InputError(folder, "its manifest.json or samples.jsonl does not describe a dataset") from error
    if kind != "patches":
        raise InputError(
            folder, f"holds {kind}, not queries of patches: make these with mesoshell dataset render-patches"
        )
    if not isinstance(manifest, dict) or not isinstance(manifest.get("source"), str):
        raise InputError(folder / "manifest.json", "lacks the field source, the mesostructure of the queries")
    if not files:
        raise InputError(folder, "has no patches yet")
    allow_files(len(files))
    return Patches(folder, manifest, tuple(_queries(path) for path in files))


def _queries(path: Path) -> np.ndarray:
    try:
        array = np.lib.format.open_memmap(path, mode="r")
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except Exception as error:  # NumPy's parser raises many types
        raise InputError(path, "not a NumPy array, or a truncated one") from error
    if array.dtype != np.float32 or array.shape[1:] != (len(COLUMNS),):
        raise InputError(path, f"is not float32 (Q, {len(COLUMNS)})")
    return array
