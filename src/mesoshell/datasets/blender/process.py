"""A Blender process that renders samples on request: the other end of `data_gen/worker.py` (standard library).

symbol    meaning
settings  what all samples of a dataset share: recipe, seed, size, samples_per_pixel, denoise, coverage, fixed, patch,
          views, tiles
request   one line of JSON to the process; answer: one line back
command   the program and its arguments; the settings are appended, as JSON

The process lives in an environment of its own, so the two talk through pipes and files alone. It ends when its input
does: an orphan at most finishes its current image.
"""

import contextlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mesoshell.errors import InputError

#: In the checkout that holds data_gen/: the current folder, or this file's. `make blender` writes `installed` there last.
_ENVIRONMENT = Path("data_gen/.venv")


class Crash(Exception):
    """The process ended without an answer; the message is one line."""


def blender_command(program: str = "data_gen.worker") -> tuple[list[str], Path]:
    """The command of one of data_gen's programs, and the folder to run it in. Raises InputError if Blender's environment is
    missing."""
    root = _checkout(_ENVIRONMENT / "installed")
    if root is None:
        raise InputError(_ENVIRONMENT, "no Blender environment; make it with: make blender")
    return [str(root / _ENVIRONMENT / "bin/python"), "-m", program], root


def _checkout(holding: Path) -> Path | None:
    return next((root for root in (Path.cwd(), Path(__file__).resolve().parents[4]) if (root / holding).exists()), None)


def check_settings(settings: Mapping[str, Any]) -> None:
    """Raises InputError for settings that no recipe takes. The recipes check them without Blender; where data_gen/ is missing,
    nothing is checked."""
    root = _checkout(Path("data_gen/worker.py"))
    if root is None:
        return
    words = [sys.executable, "-m", "data_gen.worker", json.dumps({**settings, "threads": 1})]
    output = subprocess.run(words, cwd=root, stdin=subprocess.DEVNULL, capture_output=True, text=True).stdout
    if output and "unusable" in (first := json.loads(output.splitlines()[0])):
        raise InputError("dataset", first["unusable"])


class Blender:
    """A context manager. Raises, on entry, InputError for settings that cannot be used, and Crash if it does not start."""

    def __init__(self, settings: Mapping[str, Any], threads: int, command: Sequence[str] | None = None):
        self._settings, self._threads, self._command = settings, threads, command
        self.manifest: dict[str, Any] = {}

    def __enter__(self) -> "Blender":
        try:
            words, root = (list(self._command), None) if self._command else blender_command()
        except InputError:
            check_settings(self._settings)  # report unusable settings before a missing Blender
            raise
        self._errors = tempfile.TemporaryFile("w+", errors="replace")
        try:
            self._process = subprocess.Popen(
                [*words, json.dumps({**self._settings, "threads": self._threads})],
                cwd=root,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                start_new_session=True,
            )
        except OSError as error:
            self._errors.close()
            raise Crash(f"Blender does not start: {error.strerror}") from None
        try:
            first = self._answer()
        except Crash:
            self.__exit__()
            raise
        if "unusable" in first:
            self.__exit__()
            raise InputError("dataset", first["unusable"])
        self.manifest = first["manifest"]
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin and self._process.stdout
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            with contextlib.suppress(OSError):  # a request that the process ended too soon to read
                stream.close()

    def render(self, index: int, file: Path | None, **own: Any) -> dict[str, Any]:
        """The worker's answer about a sample, whose image is then at `file`. Raises Crash if the process ended."""
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps({"index": index, "file": file and str(file), **own}) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise Crash(self._last_words()) from None
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise Crash(self._last_words())
        return json.loads(line)

    def _last_words(self) -> str:
        status = self._process.wait()
        self._errors.seek(0)
        lines = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
        how = f"Blender was ended by signal {-status}" if status < 0 else f"Blender ended with exit status {status}"
        return f"{how}: {lines[-1]}" if lines else how
