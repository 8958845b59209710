"""What a user did that we cannot use (floor 1).

The command line prints an `InputError` as one line and exits with 2; from Python it is an ordinary `ValueError`.
"""

from os import PathLike


class InputError(ValueError):
    """Unusable input. Its text is one line, `SOURCE: fault`, where SOURCE is the file or the option at fault."""

    def __init__(self, source: str | PathLike[str], fault: str):
        super().__init__(f"{source}: {fault}")
