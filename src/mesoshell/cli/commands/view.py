"""`mesoshell view`: a scene in the browser."""

import importlib.util
import threading
from dataclasses import replace

from mesoshell.cli.described_scene import compiled_by, is_mitsubas, scene_of
from mesoshell.cli.options.view import Options
from mesoshell.cli.progress import bar, stderr
from mesoshell.errors import InputError
from mesoshell.interrupt import arrived
from mesoshell.scene.materials import load_material


def run(options: Options) -> None:
    """All of `mesoshell view`."""
    if is_mitsubas(options.mesh):
        raise InputError(options.mesh, "is a scene of Mitsuba's, which the viewer does not show: give its mesh")
    if importlib.util.find_spec("viser") is None:
        raise InputError("view", "requires viser: pip install mesoshell[viewer]")
    from mesoshell.viewer.page import Page

    scene, beside = scene_of(options, load_material(options.material)), None
    if options.beside is not None:
        other = load_material(options.beside)
        beside = replace(scene, material=other, params={}, seed=None, thickness=None, scale=None)
    compiled_by(options.engine)
    with bar(stderr(), "growing") as progress:
        page = Page(scene, options.engine, options.host, options.port, progress, beside)
    print(f"{page.url} (Ctrl-C ends it)", flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        arrived()
        print()
    finally:
        page.close()
