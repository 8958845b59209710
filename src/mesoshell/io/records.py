"""JSON from elsewhere, read with one-line faults (standard library only)."""

import json
from os import PathLike
from pathlib import Path
from typing import Any

from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file


def parse_json(path: str | PathLike[str], text: bytes | str, where: str = "") -> Any:
    """Parse JSON. where: the text's place in the file, such as "line 3: ". Raises InputError if it is not JSON, or nested too
    deep for Python."""
    try:
        return json.loads(text)
    except RecursionError:
        raise InputError(path, f"{where}not JSON that can be read: nested too deep") from None
    except ValueError as error:  # UnicodeDecodeError is one
        raise InputError(path, f"{where}not JSON: {error}") from None


def read_object(path: Path) -> dict[str, Any]:
    """Read a file's JSON object. Raises InputError."""
    record = parse_json(path, read_file(path))
    if not isinstance(record, dict):
        raise InputError(path, "is not a JSON object")
    return record


def read_rows(path: Path, fields: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Read a file of one JSON object per line; none if it is missing. Values are numbers, except `name`, which is text. An
    incomplete last line, as a killed writer leaves, is skipped. Raises InputError that names the line at fault."""
    if not path.exists():
        return []
    *lines, _ = read_file(path).split(b"\n")
    rows = []
    for number, line in enumerate(lines, start=1):
        row = parse_json(path, line, f"line {number}: ")
        if not isinstance(row, dict) or not row.keys() >= set(fields):
            raise InputError(path, f"line {number}: is not a row with {', '.join(fields) or 'fields'}")
        wrong = [k for k, x in row.items() if not (_is_name(x) if k == "name" else type(x) in (int, float))]
        if wrong:
            raise InputError(path, f"line {number}: {wrong[0]} is {row[wrong[0]]!r}")
        rows.append(row)
    return rows


def _is_name(x: Any) -> bool:
    return isinstance(x, str) and x.isprintable()
