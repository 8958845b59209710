"""Options of `mesoshell scene`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mesoshell.cli.scene_options import SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Write a scene as a folder: scene.xml of Mitsuba's, with its meshes and images.

    `mesoshell render FOLDER/scene.xml --engine mitsuba` renders it, and other objects, lights and materials of Mitsuba's can be
    added to it."""

    #: Preset for the scene's paths a pixel and their depths; `render` takes its own for the rest.
    quality: Literal["draft", "normal", "reference"] = "normal"
    #: The folder, a new one.
    out: Path = Path("out/scene")
