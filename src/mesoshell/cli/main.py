"""`mesoshell VERB`: parse, run the verb, turn unusable input into one line on standard error and exit status 2."""

import functools
import sys
from collections.abc import Callable

import tyro

from mesoshell import __version__
from mesoshell.cli.commands import doctor, export, materials
from mesoshell.cli.ending import concluded, usage
from mesoshell.cli.options import atlas, dataset, distill, evaluate, fit, judge, render, texture, train

VERBS: dict[str, Callable] = {
    "render": render.run,
    "materials": materials.run,
    "fit": fit.run,
    "dataset": dataset.run,
    "train": train.run,
    "evaluate": evaluate.run,
    "judge": judge.run,
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
    status = concluded(lambda: _parsed(given)(), debug)
    if status:
        sys.exit(status)


def _parsed(given: list[str]) -> Callable[[], None]:
    """The verb with its options, to be called. Ends with status 2 and one line if there is none such."""
    later = {name: _later(verb) for name, verb in VERBS.items()}
    with usage():
        return tyro.extras.subcommand_cli_from_dict(
            later,
            prog="mesoshell",
            description="Grass, carpet and fur for any mesh, as neural reflectance shells. "
            "--debug after any verb shows the traceback of an error.",
            args=given,
        )


def _later(verb: Callable) -> Callable[..., Callable[[], None]]:
    @functools.wraps(verb)
    def bound(*arguments: object, **named: object) -> Callable[[], None]:
        return functools.partial(verb, *arguments, **named)

    return bound
