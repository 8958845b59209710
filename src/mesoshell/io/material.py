"""Materials by name, and values of their parameters (NumPy only).

Notation
α, β        appearance and geometry parameters in the order of the bundle, each normalised to [0, 1] by its range
"""

import hashlib
from difflib import get_close_matches
from importlib import resources
from importlib.util import find_spec
from os.path import isfile
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.io.archive import MANIFEST
from mesoshell.io.bundle import Bundle

#: The argument that errors about parameter values name, unless the caller gives another.
PARAMS = Argument("params")


#: A package of larger materials, and which it has.
LARGER, WITH = "mesoshell_materials", ("pelt", "turf")
INSTALL = "mesoshell-materials: pip install ./packages/materials of mesoshell's repository"


def bundled_materials() -> dict[str, Path]:
    """Materials that come with the package, and with `LARGER` where it is installed, by name."""
    folders = [Path(str(resources.files("mesoshell") / "assets"))]
    if (found := find_spec(LARGER)) and found.origin:
        folders.append(Path(found.origin).parent)
    files = {p.stem: p for folder in folders for p in folder.glob("*.npz")}
    return dict(sorted(files.items()))


def find(name: str) -> Path:
    """Path of a bundled material, or `name` itself if it is a file or folder. Raises InputError if it is neither."""
    if name in bundled_materials():
        return bundled_materials()[name]
    if isfile(name) or isfile(Path(name) / MANIFEST):  # of a name of any length
        return Path(name)
    if name in WITH:
        raise InputError(name, f"is in a package of its own, {INSTALL}")
    known = ", ".join(bundled_materials()) or "(none bundled)"
    raise InputError(name, f"no such material: give a .npz file, a material's folder, or one of {known}")


def digest(path: Path) -> str:
    """SHA-256 of a material's bytes: of its file, or of all files of its folder."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    total = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            total.update(hashlib.file_digest(stream, "sha256").digest())
    return total.hexdigest()


def check_name(bundle: Bundle, name: str, source: str = PARAMS) -> None:
    """Raise InputError, with a suggestion, unless the material has a parameter of this name."""
    known = [p.name for p in bundle.parameters]
    if name not in known:
        near = get_close_matches(name, known, 1)
        meant = f"did you mean {near[0]}?" if near else f"this material has {', '.join(known) or 'none'}"
        raise InputError(source, f"no parameter '{name}'; {meant}")


def parameter_vector(
    bundle: Bundle, values: dict[str, float], role: str = "alpha", source: str = PARAMS
) -> Float[np.ndarray, "A"]:
    """α or β from parameter values, with defaults for missing ones. Raises InputError for an unknown name or a value outside
    its range."""
    ranges = {p.name: p.range for p in bundle.parameters}
    for name, value in values.items():
        check_name(bundle, name, source)
        low, high = ranges[name]
        if not low <= value <= high:
            raise InputError(source, f"{name}={value:g} lies outside [{low:g}, {high:g}]")
    mine = [p for p in bundle.parameters if p.role == role]
    return np.array(
        [(values.get(p.name, p.default) - p.range[0]) / (p.range[1] - p.range[0]) for p in mine], np.float32
    )
