"""Errors of the library in words of the command line: options in the place of arguments."""

import re

from mesoshell.errors import Argument, InputError
from mesoshell.render.quality import SETTINGS

#: Options whose names differ from the library's arguments, and those that error messages name in backticks.
_NAMES = {name: f"--set {name}" for name in SETTINGS}
_NAMES |= {
    "params": "--param",
    "lights": "--light",
    "objects": "--object",
    "also": "--grow, --object",
    "base_colour": "--base",
}
_NAMES |= {
    name: f"--{name.replace('_', '-')}"
    for name in (
        "engine",
        "scale",
        "orbit",
        "dolly",
        "keys",
        "spp",
        "max_depth",
        "max_samples",
        "hosts",
        "coordinator",
        "scheduler",
    )
}


def spoken(fault: InputError) -> str:
    """The error's line, with options in the place of arguments."""
    source = fault.source
    if isinstance(source, Argument):
        further, _, name = source.rpartition(":")
        source = _NAMES.get(source, f"--{source.replace('_', '-')}")
        if further:  # of a further material
            source = f"--param {further}" + (f":{name}" if name != "params" else "")
    return str(InputError(source, re.sub(r"`(\w+)`", lambda m: _NAMES.get(m[1], m[0]), fault.fault)))
