"""`mesoshell VERB`: read its options, then import and call what does the work. A fault is one line and exit status 2."""

import sys
from importlib import import_module
from typing import Any

import tyro

from mesoshell import __version__
from mesoshell.cli.ending import run_command, usage
from mesoshell.cli.options import (
    atlas,
    dataset,
    distill,
    doctor,
    evaluate,
    export,
    film,
    fit,
    judge,
    materials,
    prefilter,
    render,
    scene,
    stability,
    texture,
    tradeoff,
    train,
    view,
)

_VERBS = (
    render,
    view,
    film,
    tradeoff,
    stability,
    scene,
    materials,
    fit,
    prefilter,
    dataset,
    train,
    evaluate,
    judge,
    export,
    texture,
    distill,
    atlas,
    doctor,
)
#: The options of each verb, which has the name of their file.
VERBS: dict[str, type] = {module.__name__.rpartition(".")[2]: module.Options for module in _VERBS}
#: "module:function" in cli/commands that does what these options ask for.
COMMANDS: dict[type, str] = {
    render.Options: "render:run",
    view.Options: "view:run",
    film.Options: "film:run",
    tradeoff.Options: "tradeoff:run",
    stability.Options: "stability:run",
    scene.Options: "scene:run",
    materials.Options: "materials:run",
    fit.Options: "fit:run",
    prefilter.Options: "prefilter:run",
    dataset.Render: "dataset_blender:render",
    dataset.RenderPatches: "dataset_queries:run",
    dataset.Check: "dataset:check",
    dataset.Pack: "dataset:pack",
    dataset.Sheet: "dataset:sheet",
    dataset.Vary: "dataset_blender:vary",
    dataset.Cost: "dataset_blender:cost",
    train.Options: "train:run",
    evaluate.Options: "evaluate:run",
    judge.Blind: "judge_blind:make_sheet",
    judge.Marks: "judge_blind:count_marks",
    judge.Scores: "judge_scores:run",
    export.Options: "export:run",
    texture.Options: "texture:run",
    distill.Options: "distill:run",
    atlas.Capture: "atlas_capture:run",
    atlas.Train: "atlas:train",
    atlas.Texture: "atlas:texture",
    atlas.Render: "atlas:render",
    atlas.Mesh: "atlas:mesh",
    doctor.Options: "doctor:run",
}


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `mesoshell` command."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given in (["--version"], ["-V"]):
        print(__version__)
        return
    debug = "--debug" in given
    given = [a for a in given if a != "--debug"]
    status = run_command(lambda: _call(_parsed(given)), debug)
    if status:
        sys.exit(status)


def _parsed(given: list[str]) -> Any:
    """The options of a verb, or of a verb's own verb. Ends with status 2 and one line if there is no such verb."""
    with usage(given[0] if given and given[0] in VERBS else ""):
        options = tyro.extras.subcommand_cli_from_dict(
            VERBS,
            prog="mesoshell",
            description="Grass, carpet and fur for any mesh, as neural reflectance shells. "
            "--debug after any verb shows the traceback of an error.",
            args=given,
        )
    return getattr(options, "command", options)


def _call(options: Any) -> None:
    """Do what the options ask for."""
    module, _, function = COMMANDS[type(options)].partition(":")
    getattr(import_module(f"mesoshell.cli.commands.{module}"), function)(options)
