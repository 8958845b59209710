"""`mesoshell stability`: what is hard about the user's scene."""

import json
import sys

from mesoshell.cli.checks import ends_in
from mesoshell.cli.described_scene import compiled_by, is_mitsubas, scene_of
from mesoshell.cli.options.stability import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import move_together, probe_outputs, replace_file
from mesoshell.stability.examine import examine


def run(options: Options) -> None:
    """All of `mesoshell stability`. Ends with status 1 if a bound is broken."""
    ends_in(options.out, ".png")
    if is_mitsubas(options.mesh):
        raise InputError(options.mesh, "is a scene of Mitsuba's, whose walk is not checked: give its mesh")
    outputs = options.out, options.out.with_suffix(".json")
    probe_outputs(outputs)
    compiled_by("jax")
    with bar(stderr(), "checking") as progress:
        scene = scene_of(options)
        stability = examine(scene, options.rays, progress, options.engine)
    record = {"checks": [check.as_dict() for check in stability.checks]}
    with move_together(options.out) as folder:
        replace_file(folder / outputs[0].name, stability.map())
        replace_file(folder / outputs[1].name, (json.dumps(record, indent=1) + "\n").encode())
    say_notes(stderr(), stability.notes)
    print(stability)
    print(options.out)
    if stability.broken:
        sys.exit(1)
