"""`mesoshell scene`: a described scene as Mitsuba's XML."""

from mesoshell.cli.described_scene import is_mitsubas, scene_of
from mesoshell.cli.options.scene import Options
from mesoshell.cli.progress import say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_folder
from mesoshell.render.quality import PRESETS
from mesoshell.scene.mitsuba_xml import write_folder


def run(options: Options) -> None:
    """All of `mesoshell scene`."""
    if is_mitsubas(options.mesh):
        raise InputError(options.mesh, "is a scene of Mitsuba's already")
    if options.engine != "jax":
        raise InputError("--engine", "has no effect here: the scene is written for Mitsuba")
    probe_folder(options.out, "--out")
    scene = scene_of(options)
    path, notes = write_folder(scene, options.out, PRESETS[options.quality])
    say_notes(stderr(), notes)
    print(path)
