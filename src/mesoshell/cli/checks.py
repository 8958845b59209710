"""Checks of options, before any work is done."""

from collections.abc import Sequence
from pathlib import Path

from mesoshell.errors import Argument, InputError


def at_least(options: object, **least: int) -> None:
    """Raise InputError for an option below its least value; of a pair, both numbers must reach it."""
    for name, low in least.items():
        given = getattr(options, name)
        value = min(given) if isinstance(given, tuple) else given
        if value is not None and value < low:
            raise InputError(Argument(name), f"must be at least {low}, not {value}")


def ends_in(path: Path, *suffixes: str) -> None:
    """Raise InputError unless the path has one of these suffixes."""
    if path.suffix.lower() not in suffixes:
        raise InputError(path, f"must end in {' or '.join(suffixes)}")


def params_of(given: Sequence[str]) -> dict[str, str]:
    """NAME=VALUE pairs, by name. Raises InputError for anything else."""
    pairs = {}
    for text in given:
        name, _, value = text.partition("=")
        if not (name and value):
            raise InputError("--param", f"'{text}' is not NAME=VALUE")
        pairs[name] = value
    return pairs
