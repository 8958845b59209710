"""Options of `mesoshell tradeoff`."""

from dataclasses import dataclass
from pathlib import Path

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Measure what accuracy costs in time in a scene: settings are varied one by one and together, against a reference.

    Writes report.html, front.json and points.csv. A run that was stopped goes on where it was."""

    #: Width and height of the pictures in pixels. Details of more pixels are finer, and need more of some settings. An XML
    #: scene keeps its proportions, with at most as many pixels.
    size: tuple[int, int] = (96, 96)
    #: Minutes that it takes, but for starting and the last settings under way; the reference has a third of them at most.
    minutes: float = 10.0
    #: Folder for all that is measured.
    out: Path = Path("out/tradeoff")
