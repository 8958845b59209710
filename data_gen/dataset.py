"""The dataset folder: manifest, rows, and what is already done.  Standard library only.

Alphabet
    row       one JSON object a line in samples.jsonl; written after its image has its final name
    settings  all of the manifest but `count`: what two runs must share to write into one folder
    count     samples planned, indices 0 … count − 1: the largest that any run has asked for

Several processes may write into one folder (shards of the indices): each change of the two text files happens
under a lock on the folder, and reads the file afresh.
"""

import contextlib
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path


class UnusableInput(Exception):
    """The user's input cannot be used; the message is one line."""


class Dataset:
    """An output folder opened for writing. Raises `UnusableInput` if it holds a dataset of other settings."""

    def __init__(self, folder: Path, settings: dict, count: int) -> None:
        self.folder = folder
        try:
            (folder / "images").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UnusableInput(f"{folder}: cannot be made: {error.strerror}") from None
        with self._locked():
            self._open_manifest(json.loads(json.dumps(settings)), count)
            self.done = self._keep_whole_rows()

    def image(self, index: int) -> str:
        """Name of a sample's image, relative to the folder."""
        return f"images/{index:06d}.exr"

    def partial(self, index: int) -> Path:
        return self.folder / (self.image(index) + ".partial")

    def finish(self, index: int, row: dict) -> None:
        """Give the partial image its name, then append the row with its digest."""
        partial = self.partial(index)
        digest = hashlib.sha256(partial.read_bytes()).hexdigest()
        partial.replace(self.folder / self.image(index))
        line = json.dumps({"index": index, "file": self.image(index), "sha256": digest, **row}) + "\n"
        with self._locked(), self._rows.open("ab") as rows:
            rows.write(line.encode())

    @property
    def _rows(self) -> Path:
        return self.folder / "samples.jsonl"

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        handle = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        finally:
            os.close(handle)

    def _open_manifest(self, settings: dict, count: int) -> None:
        path = self.folder / "manifest.json"
        if path.exists():
            try:
                found = json.loads(path.read_text())
                count = max(count, found.pop("count"))
            except (ValueError, KeyError, AttributeError):
                raise UnusableInput(f"{path}: not a manifest") from None
            for key in sorted(settings.keys() | found.keys()):
                if settings.get(key) != found.get(key):
                    raise UnusableInput(f"{path}: has {key} {found.get(key)}, asked for {settings.get(key)}")
        replace_text(path, json.dumps({**settings, "count": count}, indent=1) + "\n")

    def _keep_whole_rows(self) -> set[int]:
        """Indices whose row and image both exist.  Other rows, and a line cut short, are dropped."""
        if not self._rows.exists():
            return set()
        text = self._rows.read_text()
        lines = text.splitlines(keepends=True)
        kept = {}
        for line in lines:
            if line.endswith("\n"):
                row = self._parse(line)
                if (self.folder / row["file"]).exists():
                    kept.setdefault(row["index"], line)
        if len(kept) != len(lines):
            replace_text(self._rows, "".join(kept.values()))
        return set(kept)

    def _parse(self, line: str) -> dict:
        try:
            row = json.loads(line)
            return {"index": row["index"], "file": row["file"]}
        except (ValueError, KeyError, TypeError):
            raise UnusableInput(f"{self._rows}: a line is not a sample: {line[:40].strip()}") from None


def replace_text(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text)
    partial.replace(path)
