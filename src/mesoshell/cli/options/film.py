"""Options of `mesoshell film`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mesoshell.cli.scene_options import SETTINGS_HELP, SceneOptions


@dataclass(frozen=True)
class Options(SceneOptions):
    """Render a film of a scene, frame by frame; a film that was stopped goes on where it was.

    Writes an MP4, or a folder of frames, and with them film.json: seconds and flicker of each frame. Give one of --orbit,
    --dolly and --keys."""

    #: Frames of one turn of the camera around what it looks at.
    orbit: int | None = None
    #: Frames of a dolly toward the scene: it begins at --far times the camera's distance, and ends at the camera.
    dolly: int | None = None
    #: Start of the dolly, as a multiple of the camera's distance. Default: 8.
    far: float | None = None
    #: JSON file of keys: camera, parameters and thickness at some frames, smooth between them (docs/how_to/film.md).
    #: NAME:PARAMETER is a further material's.
    keys: Path | None = None
    #: Strength of a wind, above 0 to 1, that blows toward the right of the picture, over materials with a lean, as carpet:
    #: gusts move over the surface, and each frame grows its own texture.
    wind: float | None = None
    #: Frames a second.
    fps: float = 24.0
    #: Effort a frame: draft, normal or reference.
    quality: Literal["draft", "normal", "reference"] = "normal"
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(help=SETTINGS_HELP)] = ()
    #: Processes that render frames side by side, each with its share of the cores, and a copy of the scene in memory. Default:
    #: none but this one.
    workers: int | None = None
    #: Address of a Dask scheduler whose workers render the frames; they see the folder under the same path.
    scheduler: str | None = None
    #: A folder for the frames; or an .mp4 file, which needs the extra `film` and keeps its frames in a folder beside it.
    out: Path = Path("out/film")
