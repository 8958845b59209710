"""What the library says, in the words of the command line: its arguments are options here."""

import re

from mesoshell.errors import Argument, InputError

#: Options that are named otherwise than the library's arguments, and others that its sentences name.
_NAMES = {"params": "--param", "lights": "--light", "objects": "--object", "base_colour": "--base"}
_NAMES |= {name: f"--{name}" for name in ("engine", "scale", "spp")}


def spoken(fault: InputError) -> str:
    """The line of an error, with options for arguments."""
    source = fault.source
    if isinstance(source, Argument):
        source = _NAMES.get(source, f"--{source.replace('_', '-')}")
    return str(InputError(source, re.sub(r"`(\w+)`", lambda m: _NAMES.get(m[1], m[0]), fault.fault)))
