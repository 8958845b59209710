"""What a client takes home of a viewer: its picture, a scene of Mitsuba's, and the command line that renders it.

All is made in memory and downloaded by the browser: nothing is written where the viewer runs, but for a temporary folder.
"""

import io
import time
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.image import exr_bytes, png_bytes
from mesoshell.scene.mitsuba_xml import write_folder
from mesoshell.viewer.look import command
from mesoshell.viewer.work import Workshop

#: Seconds that a picture is waited for.
PATIENCE = 60.0


class Downloads:
    """The buttons of the folder "Save"."""

    def __init__(self, gui: Any, work: Workshop, engine: str):
        self._work, self._engine = work, engine
        with gui.add_folder("Save"):
            gui.add_button("PNG").on_click(partial(self._picture, "png"))
            gui.add_button("EXR").on_click(partial(self._picture, "exr"))
            gui.add_button("Scene", hint="of Mitsuba's, with its meshes and images, zipped").on_click(self._scene)
            gui.add_button("Command").on_click(self._say_command)
            self._command = gui.add_markdown("")

    def _picture(self, kind: Literal["png", "exr"], event: Any) -> None:
        def whole() -> Float[np.ndarray, "H W 4"] | None:
            picture, current = self._work.picture(event.client_id)
            return picture.rgba if current and picture is not None and picture.whole else None

        eye = event.client_id
        say = partial(self._work.say, ("save", eye))
        send_picture(event.client, whole, lambda: self._work.look.side if self._work.knows(eye) else 0, kind, say)

    def _scene(self, event: Any) -> None:
        if self._work.picture(event.client_id)[0] is None or event.client is None:
            return
        packed = io.BytesIO()
        with TemporaryDirectory() as parent:
            folder = Path(parent) / "scene"
            try:
                write_folder(self._work.described(event.client_id), folder, self._work.look.settings)
            except (InputError, OSError) as fault:
                self._work.say("scene", str(fault))
                return
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
                for path in sorted(folder.iterdir()):
                    file.write(path, f"scene/{path.name}")
        self._work.say("scene", "")
        event.client.send_file_download("scene.zip", packed.getvalue(), save_immediately=True)

    def _say_command(self, event: Any) -> None:
        picture, _ = self._work.picture(event.client_id)
        if picture is not None:
            work = self._work
            line = command(work.given, work.scene(event.client_id), work.look, self._engine, picture.samples)
            self._command.content = f"    {line}"


def send_picture(
    client: Any,
    whole: Callable[[], Float[np.ndarray, "H W 4"] | None],
    side: Callable[[], int],
    kind: Literal["png", "exr"],
    say: Callable[[str], None],
) -> None:
    """Have a client download its picture, once there is one that shows what is wished for and is no coarse one. whole: the
    picture, None while it shows something else; side: of one that is not coarse, 0 once the client is gone."""
    end = time.monotonic() + PATIENCE
    while (rgba := whole()) is None or max(rgba.shape[:2]) < side():
        if not side():
            return
        say("the picture is saved once it is whole")
        if time.monotonic() > end:
            say("the picture is not whole yet: save it later")
            return
        time.sleep(0.1)
    say("")
    if client is not None:
        data = png_bytes(rgba) if kind == "png" else exr_bytes(rgba)
        client.send_file_download(f"mesoshell.{kind}", data, save_immediately=True)
