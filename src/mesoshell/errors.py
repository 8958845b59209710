"""What a user did that we cannot use.

The command line prints an `InputError` as one line and exits with 2; from Python it is an ordinary `ValueError`.
"""

from os import PathLike

#: Characters of a fault's text that are shown, at most: a file may hold a field of a gigabyte.
LONGEST = 1000


class Argument(str):
    """Name of a Python argument that is at fault. The command line says its option instead, and so for `name`s in the text."""


class InputError(ValueError):
    """Unusable input. Its text is one line, `SOURCE: fault`, where SOURCE is the file, the argument or the option at fault."""

    def __init__(self, source: str | PathLike[str], fault: str):
        super().__init__(one_line(f"{source}: {fault}"))
        self.source, self.fault = source, fault


def one_line(text: str) -> str:
    """The text with what would break a line, or the terminal, as escapes; its middle is left out if it is long."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} … {text[-LONGEST // 4 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
