"""The scene that all benchmarks share: the bundled mesh under the bundled grass."""

from importlib import resources
from pathlib import Path

from mesoshell.cli.marching import build_scene
from mesoshell.cli.render import Options
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.shell.scene import Scene


def spot(size: int) -> Scene:
    mesh = Path(str(resources.files("mesoshell") / "assets" / "spot.obj"))
    return build_scene(Options(mesh=mesh, size=(size, size)), read_bundle(find("grass")))[0]
