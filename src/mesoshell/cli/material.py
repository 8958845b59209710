"""Where a material named on the command line lies."""

from importlib import resources
from pathlib import Path

from mesoshell.errors import InputError


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
