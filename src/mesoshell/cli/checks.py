"""Checks of options, before any work is done."""

import contextlib
from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from mesoshell.errors import Argument, InputError
from mesoshell.render.quality import kind_of, unknown


def at_least(options: object, **least: int) -> None:
    """Raise InputError for an option below its least value; of a pair, both numbers must reach it."""
    for name, low in least.items():
        given = getattr(options, name)
        value = min(given) if isinstance(given, tuple) else given
        if value is not None and value < low:
            raise InputError(Argument(name), f"must be at least {low}, not {value}")


def requires(options: Any, other: str, *names: str) -> None:
    """Raise InputError for an option that is given without another, without which it has no effect."""
    defaults = {field.name: field.default for field in fields(options)}
    for name in names:
        if not getattr(options, other) and getattr(options, name) != defaults[name]:
            raise InputError(Argument(name), f"requires --{other}")


def first_given(options: Any, among: Collection[str]) -> tuple[str, str] | None:
    """The name of the first of some options that is not as by default, and the option; None if all are."""
    for field in fields(options):
        if field.name in among and getattr(options, field.name) != field.default:
            return field.name, f"--{'no-' * (field.default is True)}{field.name.replace('_', '-')}"
    return None


def ends_in(path: Path, *suffixes: str) -> None:
    """Raise InputError unless the path has one of these suffixes."""
    if path.suffix.lower() not in suffixes:
        raise InputError(path, f"must end in {' or '.join(suffixes)}")


def pairs_of(option: str, given: Sequence[str]) -> dict[str, str]:
    """An option's NAME=VALUE pairs, by name. Raises InputError for anything else."""
    pairs = {}
    for text in given:
        name, _, value = text.partition("=")
        if not (name and value):
            raise InputError(option, f"'{text}' is not NAME=VALUE")
        pairs[name] = value
    return pairs


def settings_of(given: Sequence[str]) -> dict[str, Any]:
    """Fields of a quality, from `--set`; what is no value of its field stays text. Raises InputError for what is no pair, or no
    field."""
    pairs = pairs_of("--set", given)
    for name in pairs:
        if fault := unknown(name):
            raise InputError(f"--set {name}", fault)
    return {name: _value(kind_of(name), text) for name, text in pairs.items()}


def _value(kind: type, text: str) -> Any:
    with contextlib.suppress(KeyError, ValueError):
        return {"true": True, "false": False}[text.lower()] if kind is bool else kind(text)
    return text
