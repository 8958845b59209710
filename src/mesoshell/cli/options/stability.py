"""Options of `mesoshell stability`."""

from dataclasses import dataclass
from pathlib import Path

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Check what is hard about a scene: folds, edges, grazing rays, precision. A line a check; exit status 1 if one is BAD.

    Writes a map of where, and the numbers as JSON beside it."""

    #: Rays that are aimed at vertices, edges and sides, and along the top; the camera's come on top.
    rays: int = 100_000
    #: PNG file for the map.
    out: Path = Path("out/stability.png")
