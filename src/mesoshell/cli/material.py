"""A material named on the command line: where it lies, and the parameters given for it."""

from importlib import resources
from pathlib import Path

import numpy as np

from mesoshell.cli.render import parse_params
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.image import read_png


def bundled() -> dict[str, Path]:
    """Materials that come with the package, by name."""
    folder = Path(str(resources.files("mesoshell") / "assets"))
    return {p.stem: p for p in sorted(folder.glob("*.npz"))}


def find(name: str) -> Path:
    """A bundled material's file, or the file that `name` itself is. Raises InputError if it is neither."""
    if name in bundled():
        return bundled()[name]
    if Path(name).is_file():
        return Path(name)
    raise InputError(name, f"no such material: give a .npz file, or one of {', '.join(bundled()) or '(none bundled)'}")


def given(bundle: Bundle, params: tuple[str, ...]) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """NAME=VALUE pairs: numbers, in the parameters' units, and grey images (H, W). Raises InputError for a name that the
    material does not have, or what is neither a number nor an image."""
    known = [p.name for p in bundle.parameters]
    values, maps = {}, {}
    for name, text in parse_params(params).items():
        if name not in known:
            raise InputError("--param", f"no parameter '{name}'; this material has {', '.join(known) or 'none'}")
        try:
            values[name] = float(text)
        except ValueError:
            if not Path(text).is_file():
                raise InputError("--param", f"{name}={text} is neither a number nor an image file") from None
            maps[name] = read_png(Path(text))[..., :3].mean(axis=-1).astype(np.float32)
    return values, maps
