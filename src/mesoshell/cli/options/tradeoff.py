"""Options of `mesoshell tradeoff`."""

from dataclasses import dataclass
from pathlib import Path

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Measure error against render time in a scene: vary settings one by one and together, and compare with a reference.

    Writes report.html, front.json and points.csv. A run that was stopped goes on where it was."""

    #: Width and height of the pictures in pixels. Larger pictures show finer detail, which needs higher values of some
    #: settings. An XML scene keeps its proportions, with at most as many pixels.
    size: tuple[int, int] = (96, 96)
    #: Time limit in minutes, with set-up of the scene; settings under way at its end are finished. The reference takes 0.3 of
    #: it, or 16 passes if these take longer.
    minutes: float = 10.0
    #: Folder for all that is measured.
    out: Path = Path("out/tradeoff")
