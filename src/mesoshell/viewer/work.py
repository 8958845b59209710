"""What a viewer of a scene does beside its page: pictures of a look, and, in a thread beside them, textures that it wants."""

from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.surface import KIND
from mesoshell.scene.materials import Material
from mesoshell.scene.prepare import check_engine
from mesoshell.scene.scene import Scene
from mesoshell.scene.settle import settle
from mesoshell.scene.setup import check_irradiance, describe_shell, describe_surface, with_distant_lamps
from mesoshell.scene.unpack import unpack
from mesoshell.viewer.look import Look, describe_look, first_look, scene_of_look, with_size, with_textures_of
from mesoshell.viewer.refine import Abandoned, RefinedPicture, refine
from mesoshell.viewer.views import View, Views, fault_line


class Workshop(Views[RefinedPicture]):
    """Paints what eyes see of a scene. growing: called with the share of a texture that is grown, 1 at the end. notes: what
    the user should know, a line each."""

    def __init__(
        self,
        scene: Scene,
        show: Callable[[Any], None],
        say: Callable[[str], None],
        growing: Callable[[float], None],
        engine: str = "jax",
        progress: Callable[[float], None] = lambda share: None,
        paint_lock: AbstractContextManager | None = None,
    ):
        """Settles the scene. Raises InputError."""
        super().__init__(show, say, paint_lock)
        self.given, scene = scene, unpack(scene)
        self._lit = bool(scene.lights) or bool(scene.lamps) or scene.environment is not None
        check_engine(scene, engine)
        check_irradiance("irradiance", np.array(scene.irradiance, np.float64))
        if scene.material.kind == KIND:
            describe_surface(scene)  # raises what a picture of it would
        self.notes: tuple[str, ...] = ()
        self.begun = settle(scene, texture=False)
        self.still = settle(self.begun, progress)
        if scene.material.kind != KIND:
            d = describe_shell(self.still)  # once its texture is grown
            self.notes = (*d.notes, *(with_distant_lamps(d, [x.mesh for x in d.growths])[1] if engine == "jax" else ()))
        self.look = first_look(self.begun)
        self._textures: tuple[tuple | None, ...] = self.look.textures(self.begun)
        self._failed: tuple[tuple, ...] | None = None  # what could not be grown, and is not tried again
        self._growing, self._engine = growing, engine
        self._start(self._grow)

    def set(self, look: Look) -> None:
        """Show another look to all."""
        with self._changed:
            if look == self.look:
                return
            self.look = look
            self._ask_all()
            there = look.textures(self.begun) == self._textures
            self._failed = None if there else self._failed
        if there:
            self.say("texture", "")

    def set_material(self, material: Material) -> None:
        """Show another material with the same parameters, once its texture is grown. Raises InputError for one with others."""
        now = self.begun.material
        if (material.kind, material.parameters) != (now.kind, now.parameters):
            raise InputError(material.name, f"has other parameters than {now.name}")
        with self._changed:
            self.begun, self._textures = replace(self.begun, material=material), (None, *self._textures[1:])
            self._failed = None
            self._changed.notify_all()

    def scene(self, eye: Hashable) -> Scene:
        """What an eye sees now."""
        with self._changed:
            return self._scene(self._views[eye])

    def described(self, eye: Hashable) -> Scene:
        """What an eye sees, as it could be given: with parameters in place of a grown texture."""
        with self._changed:
            camera = with_size(self._views[eye].camera, self.look.side)
            return describe_look(self.begun, self.look, camera, self._lit)

    def _scene(self, view: View) -> Scene:
        return scene_of_look(self.begun, self.still, self.look, with_size(view.camera, self.look.side), self._lit)

    def _refined(self, view: View[RefinedPicture], stopped: Callable[[], bool]) -> Iterator[RefinedPicture]:
        own = view.quality is None
        quality, changes = view.quality or self.look.quality, self.look.changes if own else {}
        return refine(self._scene(view), quality, stopped, engine=self._engine, coarse=own, changes=changes)

    def _grow(self) -> None:
        while self._open:
            with self._changed:
                while self._open and self.look.textures(self.begun) in (self._textures, self._failed):
                    self._changed.wait()
                begun, wanted = self.begun, self.look.textures(self.begun)
                asked = with_textures_of(begun, self.still, self.look, self._textures)
            if not self._open:
                return

            def check(share: float, wanted: tuple = wanted, begun: Scene = begun) -> None:
                if not self._open or self.look.textures(begun) != wanted:
                    raise Abandoned
                self._growing(share)

            made = None
            try:
                made = settle(asked, check)
            except Abandoned:
                self._growing(1.0)
                continue
            except Exception as fault:
                if self.look.textures(begun) == wanted:
                    self.say("texture", fault_line(fault))
            else:
                self.say("texture", "")
            with self._changed:
                self._failed = wanted if made is None and self.begun is begun else None
                if made is not None:
                    if self.begun is begun:
                        self._textures = wanted
                    self.still, self.given = made, replace(self.given, material=begun.material)
                self._ask_all()
            self._growing(1.0)
