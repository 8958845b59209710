"""What the pages of one picture an eye share, by viser: a browser's camera, its picture, and saving it."""

import threading
from typing import Any, Literal

import numpy as np

from mesoshell.io.image import srgb_codes
from mesoshell.viewer.browser import camera_of, reach, set_text
from mesoshell.viewer.compare import over_white
from mesoshell.viewer.downloads import send_picture
from mesoshell.viewer.page import JPEG


class EyesPage:
    """Who inherits sets `_server`, `work`, `_cost` and `_fault`, and says what a picture's passes cost, and how large it all
    is."""

    work: Any
    _server: Any
    _cost: Any
    _fault: Any

    def __init__(self) -> None:
        self._sending, self._moving = threading.Lock(), threading.Lock()

    def _size(self) -> float:
        """About how large what is seen is, world."""
        raise NotImplementedError

    def _cost_of(self, picture: Any) -> str:
        """What a picture's passes cost."""
        raise NotImplementedError

    def _connected(self, client: Any) -> None:
        client.camera.min_orbit_distance = reach(self._size())[0]
        client.camera.on_update(lambda _: self._moved(client))
        self._moved(client)

    def _moved(self, client: Any) -> None:
        with self._moving:
            camera = camera_of(client.camera)
            if camera is not None:
                self.work.see(client.client_id, camera)

    def _show(self, number: int) -> None:
        """A picture has refined."""
        client = self._server.get_clients().get(number)
        if client is None:  # it left in the meantime
            self.work.leave(number)
            return
        with self._sending:
            picture, _ = self.work.picture(number)
            if picture is None:
                return
            codes = srgb_codes(over_white(picture.rgba))
            client.scene.set_background_image(codes, format="jpeg", jpeg_quality=JPEG)
            self._cost.content = self._cost_of(picture)

    def _say(self, line: str) -> None:
        set_text(self._fault, line)

    def _save_picture(self, kind: Literal["png", "exr"], event: Any) -> None:
        def whole() -> np.ndarray | None:
            picture, current = self.work.picture(event.client_id)
            return picture.rgba if current and picture is not None else None

        eye = event.client_id
        send_picture(
            event.client,
            whole,
            lambda: self.work.look.side if self.work.knows(eye) else 0,
            kind,
            lambda line: self.work.say(("save", eye), line),
        )
