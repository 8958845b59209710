"""The scene that all benchmarks share: the bundled mesh under the bundled grass, half as high as its patch is wide.

Figures in docs/performance.md are of these proportions. What `mesoshell render` makes by default has patches half as wide.
"""

from importlib import resources
from pathlib import Path

from mesoshell.cli.marching import build_scene
from mesoshell.cli.render import Options
from mesoshell.io.bundle import read_bundle
from mesoshell.io.material import find
from mesoshell.shell.scene import Scene

#: Height of the shell, and side of a patch.
THICKNESS, SCALE = 0.1035, 0.207


def spot(size: int) -> Scene:
    mesh = Path(str(resources.files("mesoshell") / "assets" / "spot.obj"))
    return build_scene(
        Options(mesh=mesh, thickness=THICKNESS, scale=SCALE, size=(size, size)), read_bundle(find("grass"))
    )[0]
