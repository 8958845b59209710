"""Mesh files in a ZIP archive, as sites for models give them: unpacked for as long as this process lives.

Everything in the archive is unpacked, since a mesh may name its buffers and images; nothing outside the folder is touched.
"""

import os
import shutil
import tempfile
import threading
import zipfile
from collections.abc import Sequence
from os import PathLike
from pathlib import Path, PurePosixPath

from mesoshell.errors import InputError
from mesoshell.limits import check_memory

SUFFIX = ".zip"
#: Most files of an archive.
MOST = 10_000
#: Formats whose meshes name other files: where an archive holds one of these, its other meshes are passed over.
FIRST = (".gltf", ".usd", ".usda", ".usdc")
#: Memory that a mesh takes for each byte of its file, at most about: text of numbers, and what is made of it.
GROWS = 16
#: By its path: when an archive was written and its size, the folder, and the file in it.
_UNPACKED: dict[Path, tuple[tuple[int, int], tempfile.TemporaryDirectory, Path]] = {}
_TURN = threading.Lock()


def unzipped(path: str | PathLike[str], formats: Sequence[str]) -> Path:
    """The file of one of these formats in a .zip, unpacked; any other path as it is. Raises InputError unless there is one."""
    file = Path(path)
    if file.suffix.lower() != SUFFIX or not os.path.isfile(file):
        return file
    state, key = file.stat(), file.resolve()
    now = state.st_mtime_ns, state.st_size
    with _TURN:
        if key not in _UNPACKED or _UNPACKED[key][0] != now:
            fresh = _unpacked(file, formats)
            if key in _UNPACKED:
                _UNPACKED[key][1].cleanup()
            _UNPACKED[key] = now, *fresh
        return _UNPACKED[key][2]


def check_archive(path: Path, formats: Sequence[str]) -> list[zipfile.ZipInfo]:
    """The files in an archive. formats: whose files are read as meshes. Raises InputError if it is none, or they are too large,
    too many, or lead out of its folder."""
    try:
        with zipfile.ZipFile(path) as archive:
            files = [entry for entry in archive.infolist() if not entry.is_dir()]
    except (zipfile.BadZipFile, NotImplementedError, LookupError, ValueError, OSError) as fault:
        raise InputError(path, f"is not a readable ZIP archive ({fault})") from fault
    if len(files) > MOST:
        raise InputError(path, f"holds {len(files)} files, more than {MOST}")
    for entry in files:
        name = PurePosixPath(entry.filename.replace("\\", "/"))
        if name.is_absolute() or not name.parts or ".." in name.parts or ":" in name.parts[0]:
            raise InputError(path, f"its file {entry.filename!r} leads out of the folder")
        if entry.flag_bits & 1:
            raise InputError(path, f"its file {entry.filename!r} is encrypted")
    sizes = (x.file_size * (GROWS if Path(x.filename).suffix.lower() in formats else 1) for x in files)
    check_memory(path, "what it holds", sum(sizes))
    return files


def _unpacked(path: Path, formats: Sequence[str]) -> tuple[tempfile.TemporaryDirectory, Path]:
    files = check_archive(path, formats)
    name = _chosen(path, [x.filename for x in files], formats)
    folder = tempfile.TemporaryDirectory(prefix="mesoshell-")
    try:
        # a fault in what was unpacked then names the archive, too
        inside = Path(folder.name) / path.name
        with zipfile.ZipFile(path) as archive:
            for entry in files:
                target = inside / entry.filename.replace("\\", "/")
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(entry) as packed, target.open("wb") as out:
                    shutil.copyfileobj(packed, out)
    except Exception as fault:  # of each way of packing its own
        folder.cleanup()
        raise InputError(path, f"cannot be unpacked ({fault})") from fault
    return folder, inside / name


def _chosen(path: Path, names: Sequence[str], formats: Sequence[str]) -> str:
    """The one mesh file among names."""
    given = [PurePosixPath(name.replace("\\", "/")) for name in names]
    shown = [x for x in given if not any(part.startswith(("__MACOSX", ".")) for part in x.parts)]
    found = [x for x in shown if x.suffix.lower() in formats]
    found = [x for x in found if x.suffix.lower() in FIRST] or found
    if not found:
        raise InputError(path, f"holds no mesh of {', '.join(formats)}")
    if len(found) > 1:
        raise InputError(
            path, f"holds {len(found)} meshes: unpack it, and give one of {', '.join(map(str, sorted(found)))}"
        )
    return str(found[0])
