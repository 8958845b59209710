"""`mesoshell view`: a scene in the browser."""

import importlib.util
import threading
from dataclasses import fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

from mesoshell.cli.checks import first_given
from mesoshell.cli.described_scene import compiled_by, is_mitsubas, names_of_xml, scene_of
from mesoshell.cli.options.view import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.errors import InputError
from mesoshell.interrupt import arrived
from mesoshell.io.material import bundled_materials
from mesoshell.io.records import read_object
from mesoshell.io.surface import KIND
from mesoshell.scene.materials import load_material

#: Methods whose snapshots are materials.
MATERIALS = ("gan", "surface", "textures")
#: The method whose snapshots are objects.
OBJECTS = "atlas"


def run(options: Options) -> None:
    """All of `mesoshell view`."""
    if importlib.util.find_spec("viser") is None:
        raise InputError("view", "requires viser: pip install mesoshell[viewer]")
    from mesoshell.viewer.page import Page

    if is_mitsubas(options.mesh):
        _show(_file_page(options))
        return
    given = [options.mesh, *([] if options.material is None else [Path(options.material)])]
    objects = [x for x in given if _is_run(x) and _method(x) == OBJECTS]
    if objects:
        _show(_object_page(options, objects[0]))
        return
    _check_size(options)
    run = _run_of(options)
    if run is not None and run == options.mesh:
        options = replace(options, mesh=Path(str(resources.files("mesoshell") / "assets" / "spot.obj")))
    scene, beside = scene_of(options, None if run is None else load_material(_newest(run))), None
    if options.beside is not None:
        other = load_material(options.beside)
        if other.kind == KIND and scene.also:
            raise InputError("--beside", f"{other.name} is a surface material: only shells grow beside others")
        beside = replace(scene, material=other, params={}, seed=None, latent=None, thickness=None, scale=None)
    compiled_by(options.engine)
    with bar(stderr(), "growing") as progress:
        page = Page(scene, options.engine, options.host, options.port, progress, beside, run)
    say_notes(stderr(), page.work.notes)
    _show(page)


def _check_size(options: Options) -> None:
    if options.size is not None:
        raise InputError("--size", "a picture here is as wide as its window; its pixels are chosen on the page")


def _file_page(options: Options) -> Any:
    """The page of a scene of Mitsuba's. Raises InputError for options that it does not take."""
    _check_size(options)
    if options.beside is not None:
        raise InputError("--beside", f"{options.mesh} is a scene of Mitsuba's, which has its own materials")
    names = names_of_xml(options)
    from mesoshell.render.quality import PRESETS
    from mesoshell.scene.render_paths import MovedFile
    from mesoshell.viewer.file_page import FilePage

    return FilePage(MovedFile(options.mesh, PRESETS["normal"], names), options.host, options.port)


def _object_page(options: Options, run: Path) -> Any:
    """The page of a captured object. Raises InputError for options of a scene."""
    if run != options.mesh:
        raise InputError("--material", f"{run} is a run of an object, which is no material: give it as the mesh")
    given = first_given(options, {field.name for field in fields(options)} - {"mesh", "host", "port"})
    if given is not None:
        raise InputError(given[1], f"is of a scene, and {run} is an object")
    from mesoshell.cli.compilation_cache import keep_compiled
    from mesoshell.train.run_config import snapshots
    from mesoshell.viewer.object_page import ObjectPage

    keep_compiled()
    return ObjectPage(run, snapshots(run)[-1][1], options.host, options.port)


def _show(page: Any) -> None:
    """Until it is interrupted."""
    print(f"{page.url} (Ctrl-C ends it)", flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        arrived()
        print()
    finally:
        page.close()


def _run_of(options: Options) -> Path | None:
    """The folder of a run, in place of the mesh or of the material. Raises InputError if it is given with another material."""
    name = options.material
    if _is_run(options.mesh):
        if name is not None:
            raise InputError("--material", f"is the newest snapshot of {options.mesh}")
        return options.mesh
    return Path(name) if name is not None and name not in bundled_materials() and _is_run(Path(name)) else None


def _is_run(folder: Path) -> bool:
    """Whether a path is the folder of a training run."""
    return (folder / "config.json").is_file()


def _method(run: Path) -> Any:
    return read_object(run / "config.json").get("method", MATERIALS[0])


def _newest(run: Path) -> Path:
    """Its newest snapshot. Raises InputError if there is none, or for a method whose snapshots are no materials."""
    from mesoshell.train.run_config import snapshots

    method = _method(run)
    if method not in MATERIALS:
        raise InputError(run, f"is a run of {method}, whose snapshots are no materials")
    return snapshots(run)[-1][1]
