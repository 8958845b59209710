"""The writing end of a dataset folder: one run at a time adds rows to it (standard library only).

symbol       meaning
settings     all of manifest.json but `count`: what two runs must share to add to one folder
count        samples planned, indices 0 … count − 1: the most that any run has planned
row          one JSON object a line in samples.jsonl, written after its image has its final name
log.jsonl    what each sample cost; differs from run to run, so it is no part of the dataset

A complete dataset has sorted rows; except for the log, its bytes are the same whoever made it.
"""

import contextlib
import json
import operator
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mesoshell.errors import InputError
from mesoshell.io.atomic import left_over, replace_file
from mesoshell.io.lock import alone_in
from mesoshell.io.records import read_object


class Collector:
    """An output folder opened for writing; use `collecting`."""

    def __init__(self, folder: Path, settings: Mapping[str, Any], count: int, parts: str):
        self.folder, self._parts = folder, folder / parts
        self._rows_file, self._log_file = folder / "samples.jsonl", folder / "log.jsonl"
        self._manifest(json.loads(json.dumps(settings)), count)
        self._parts.mkdir(exist_ok=True)
        self._sweep()
        self._rows = self._whole_rows()

    def missing(self, count: int) -> list[int]:
        """Indices below count that have no row."""
        return [index for index in range(count) if index not in self._rows]

    def add(self, row: Mapping[str, Any], log: Mapping[str, Any] | None) -> None:
        """Append the row of a finished image. Raises OSError if the disk is full, and leaves no part of the row."""
        line = json.dumps(row) + "\n"
        _append(self._rows_file, line)
        self._rows[row["index"]] = line
        if log is not None:
            with contextlib.suppress(OSError):  # a dataset is complete without its log
                _append(self._log_file, json.dumps(log) + "\n")

    def sort(self) -> None:
        """Sort the rows by index, and remove what killed writers left; on a full disk rows stay unsorted, which every reader
        accepts."""
        self._sweep()
        with contextlib.suppress(InputError):
            replace_file(self._rows_file, "".join(line for _, line in sorted(self._rows.items())).encode())

    def _sweep(self) -> None:
        for partial in left_over(self._parts):
            partial.unlink(missing_ok=True)

    def _manifest(self, settings: dict[str, Any], count: int) -> None:
        path = self.folder / "manifest.json"
        if not path.exists() and (self._rows_file.exists() or any(self._parts.glob("*"))):
            raise InputError(self.folder, "has samples but no manifest.json: not a dataset folder")
        if path.exists():
            try:
                stored = read_object(path)
                count = max(count, stored.pop("count"))
            except InputError:
                raise
            except (ValueError, KeyError, AttributeError, TypeError):
                raise InputError(path, "not a manifest") from None
            for key in sorted(settings.keys() | stored.keys(), key=lambda key: (key not in ("recipe", "version"), key)):
                if settings.get(key) != stored.get(key):
                    raise InputError(path, f"has {key} {stored.get(key)}, asked for {settings.get(key)}")
        replace_file(path, (json.dumps({**settings, "count": count}, indent=1) + "\n").encode())

    def _whole_rows(self) -> dict[int, str]:
        """The line of every index whose image exists; a line cut short is dropped."""
        rows: dict[int, str] = {}
        lines = (
            self._rows_file.read_text(errors="replace").splitlines(keepends=True) if self._rows_file.exists() else []
        )
        for line in lines:
            if line.endswith("\n"):
                try:
                    row = json.loads(line)
                    index, file = operator.index(row["index"]), self.folder / row["file"]
                except (ValueError, KeyError, TypeError, RecursionError):
                    raise InputError(self._rows_file, f"a line is not a sample: {line[:40].strip()}") from None
                if os.path.exists(file):
                    rows.setdefault(index, line)
        if len(rows) != len(lines):
            replace_file(self._rows_file, "".join(rows.values()).encode())
        return rows


@contextlib.contextmanager
def collecting(folder: Path, settings: Mapping[str, Any], count: int, parts: str = "images") -> Iterator[Collector]:
    """Open a folder for this run alone, made if missing; parts: its subfolder for files. Raises InputError if it holds a
    dataset of other settings, or another run is writing into it."""
    with alone_in(folder):
        yield Collector(folder, settings, count, parts)


def _append(path: Path, line: str) -> None:
    before = path.stat().st_size if path.exists() else 0
    try:
        with path.open("ab", buffering=0) as file:
            data = line.encode()
            if file.write(data) != len(data):
                raise OSError(28, "No space left on device")
    except OSError:
        if path.exists():
            os.truncate(path, before)
        raise
