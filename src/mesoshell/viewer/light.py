"""The light of a viewer's page: the scene's own, a sun, an image that was sent."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.image import radiance_of
from mesoshell.render.camera import Camera
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import check_environment
from mesoshell.viewer.look import Sky
from mesoshell.viewer.sun import Sphere, Sun


class LightPanel:
    """A folder of a server's page. still: the scene, settled; about: where the sun's handle goes; changed: called when
    something is set; say: with what is wrong with an image, empty if nothing is."""

    def __init__(
        self, server: Any, still: Scene, about: Sphere, changed: Callable[[Any], None], say: Callable[[str], None]
    ):
        assert isinstance(still.camera, Camera)
        gui, up = server.gui, np.eye(3)[1 if still.up == "y" else 2]
        self._sky: Sky | None = None
        self._changed, self._say = changed, say
        with gui.add_folder("Light"):
            hint = "one light from here, in place of the scene's"
            self.sun = Sun(server, still.camera.to_world, up, about, hint, changed)
            self.under = gui.add_checkbox(
                "environment", False, visible=False, hint="light of the image, and of the sun"
            )
            hint = "a latitude-longitude EXR or HDR, in place of the scene's lights"
            gui.add_upload_button("Environment", hint=hint).on_upload(lambda event: self.take(event.target.value))
        self.under.on_update(changed)

    def look(self) -> dict[str, Any]:
        """Fields of a `Look`."""
        return {"sun": self.sun.sun, "sky": self._sky if self.under.value else None}

    def take(self, given: Any) -> None:
        """An image that a browser sent, under a name that a command line and a page can hold."""
        name = re.sub(r"[^\w .-]", "_", given.name.replace("\\", "/").rpartition("/")[2]).lstrip("-. ")
        name = name or "environment.exr"
        try:
            radiance = radiance_of(given.content, name)
            check_environment(radiance, name)
            self._sky = Sky(name, radiance)
        except InputError as fault:
            self._say(str(fault))
            return
        self._say("")
        self.under.visible = self.under.value = True
        self._changed(None)
