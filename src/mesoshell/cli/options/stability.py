"""Options of `mesoshell stability`."""

from dataclasses import dataclass
from pathlib import Path

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Check a scene for numerical problems: folded prisms, edges, grazing rays, precision.

    Prints one line per check, and ends with status 1 if one is BAD. Writes a map of the problem places, and the numbers as
    JSON beside it."""

    #: Number of test rays, aimed at vertices, edges and sides, and along the shell's top; the camera's rays are added.
    rays: int = 100_000
    #: PNG file for the map.
    out: Path = Path("out/stability.png")
