"""Errors in what the user gave.

The command line prints an `InputError` as one line and exits with 2; from Python it is an ordinary `ValueError`.
"""

from os import PathLike

#: Most characters of an error's text that are shown: a file may hold a field of a gigabyte.
LONGEST = 1000


class Argument(str):
    """Name of the Python argument at fault. The command line replaces it, and `name`s in the text, by the option's name."""


class InputError(ValueError):
    """Unusable input. Its text is one line, `SOURCE: fault`, where SOURCE is the file, the argument or the option at fault."""

    def __init__(self, source: str | PathLike[str], fault: str):
        super().__init__(one_line(f"{source}: {fault}"))
        self.source, self.fault = source, fault

    def __reduce__(self) -> tuple:
        return InputError, (self.source, self.fault)


def one_line(text: str) -> str:
    """Escape line breaks and unprintable characters; leave out the middle of a long text."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} … {text[-LONGEST // 4 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
