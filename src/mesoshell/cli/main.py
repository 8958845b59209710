"""`mesoshell VERB`: parse, run the verb, turn unusable input into one line on standard error and exit status 2."""

import sys
from collections.abc import Callable

import tyro

from mesoshell import __version__
from mesoshell.cli import atlas, dataset, distill, doctor, evaluate, export, fit, render, texture, train
from mesoshell.errors import InputError

VERBS: dict[str, Callable] = {
    "render": render.run,
    "fit": fit.run,
    "dataset": dataset.run,
    "train": train.run,
    "evaluate": evaluate.run,
    "export": export.run,
    "texture": texture.run,
    "distill": distill.run,
    "atlas": atlas.run,
    "doctor": doctor.run,
}


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `mesoshell` command."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given in (["--version"], ["-V"]):
        print(__version__)
        return
    debug = "--debug" in given
    given = [a for a in given if a != "--debug"]
    try:
        tyro.extras.subcommand_cli_from_dict(
            VERBS,
            prog="mesoshell",
            description="Grass, carpet and fur for any mesh, as neural reflectance shells. "
            "--debug after any verb shows the traceback of an error.",
            args=given,
        )
    except InputError as fault:
        if debug:
            raise
        print(f"mesoshell: {fault}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
