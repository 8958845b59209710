"""What is kept between commands, in one folder of the user's (standard library only).

Notation
room        a folder under $XDG_CACHE_HOME/mesoshell, or ~/.cache/mesoshell unless that is an absolute path
entry       a file or a folder in a room

Nothing there is needed: it can be removed at will, and what is damaged is made anew.
"""

import contextlib
import os
import shutil
import time
from pathlib import Path

#: Rooms, and what they hold.
ROOMS = {
    "xla": "compiled programs",
    "grown": "textures",
    "textures": "textures of XML scenes",
    "meshes": "unwrapped meshes",
    "densities": "baked densities",
}


#: Seconds after which a hidden entry, which is being written, counts as left behind.
_LEFT_BEHIND = 86400


def cache_folder(room: str) -> Path:
    """Where a room is, or will be."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(given) if os.path.isabs(given) else Path.home() / ".cache") / "mesoshell" / room


def has_space(room: str, size: int) -> bool:
    """Whether the disk of a room has three times `size` bytes left."""
    near = cache_folder(room)
    while not near.exists() and near != near.parent:
        near = near.parent
    try:
        return shutil.disk_usage(near).free > 3 * size
    except OSError:
        return False


def held(path: Path) -> int:
    """Bytes of a file, or of a folder's files; 0 if there is none."""
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def forget(room: Path, most: int, but: Path | None = None) -> None:
    """Remove what was not used for longest from a room, but not the entry `but`, nor what others are writing, until all are
    within `most` bytes."""
    found, entries = [], []
    with contextlib.suppress(OSError):  # it may not be there, or not be ours to read
        entries = list(room.iterdir())
    for entry in entries:
        with contextlib.suppress(OSError):  # another process may remove or rename it
            age = time.time() - entry.stat().st_mtime
            if not entry.name.startswith(".") or age > _LEFT_BEHIND:
                found.append((-age, entry, held(entry)))
    total = sum(size for _, _, size in found)
    for _, entry, size in sorted(found):
        if total <= most or entry == but:
            continue
        remove(entry)
        total -= size


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there and can be removed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()
