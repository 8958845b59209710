"""The scene that all benchmarks share: the bundled mesh under the bundled grass, half as high as its patch is wide.

Figures in docs/results/performance.md are of these proportions. What `mesoshell render` makes by default has patches half
as wide.
"""

from importlib import resources
from pathlib import Path

import mesoshell as ms
from mesoshell.scene.render_shell import marched_scene
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.render.scene import Scene

#: Height of the shell, and side of a patch.
THICKNESS, SCALE = 0.1035, 0.207


def spot(size: int) -> Scene:
    mesh = Path(str(resources.files("mesoshell") / "assets" / "spot.obj"))
    grass = ms.load_material("grass")
    return marched_scene(describe_shell(ms.Scene(mesh, grass, thickness=THICKNESS, scale=SCALE, size=(size, size))))
