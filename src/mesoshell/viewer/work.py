"""What a viewer does beside its page: one thread paints, another grows textures; the newest wish counts.

Notation
view        what one eye sees: its camera, and a number that grows with each wish. A client has an eye, or several to compare
"""

import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.scene.materials import Material
from mesoshell.scene.scene import Scene
from mesoshell.scene.settle import settle
from mesoshell.scene.setup import check_irradiance, describe_shell, describe_surface, with_distant_lamps
from mesoshell.scene.unpack import unpack
from mesoshell.viewer.look import Look, describe_look, first_look, scene_of_look, with_size, with_textures_of
from mesoshell.viewer.refine import Abandoned, RefinedPicture, refine

#: Seconds of rest before what takes long is begun: while a camera moves, there are only coarse pictures, and nothing has to be
#: abandoned.
PAUSE = 0.25


@dataclass
class View:
    """camera: of any size with its proportions; quality: None for the look's; wish: its number; painted: that of the picture
    under way; left: its steps; shown: how many there were of this wish; picture: the last one; rest: until when nothing is
    begun, as `time.monotonic` has it."""

    camera: Camera
    quality: str | None = None
    wish: int = 1
    painted: int = 0
    left: Iterator[RefinedPicture] | None = None
    shown: int = 0
    picture: RefinedPicture | None = None
    rest: float = 0.0

    def ask(self) -> None:
        """Another picture is wished for."""
        self.wish, self.shown = self.wish + 1, 0
        self.rest = time.monotonic() + PAUSE if self.quality is not None else 0.0

    @property
    def waits(self) -> bool:
        """Whether there is more to paint."""
        return self.painted != self.wish or self.left is not None

    @property
    def urgent(self) -> bool:
        """Whether it waits for its coarse picture, or for the first one after it."""
        return self.quality is None and self.shown < 2 and self.waits


class Workshop:
    """Paints what eyes see of a scene. show: called with an eye whose picture has refined; say: with a line for all, empty
    when a fault is over; growing: with the share of a texture that is grown, 1 at the end. Callbacks come from threads of its
    own. notes: what the user should know, a line each."""

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
        """Settles the scene. paint_lock: what workshops that paint in turn share. Raises InputError."""
        self.given, scene = scene, unpack(scene)
        self._lit = bool(scene.lights) or bool(scene.lamps) or scene.environment is not None
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
        self._show, self._tell, self._growing, self._engine = show, say, growing, engine
        self._faults = {"picture": "", "texture": "", "scene": "", "environment": "", "snapshot": "", "run": ""}
        self._views: dict[Hashable, View] = {}
        self._changed, self._open, self._turn = threading.Condition(), True, 0
        self._paint_lock, self._telling = paint_lock or threading.Lock(), threading.Lock()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._paint, self._grow)]
        for thread in self._threads:
            thread.start()

    def see(self, eye: Hashable, camera: Camera, quality: str | None = None) -> None:
        """An eye looks from here. quality: of its pictures alone, which have no coarse one before; None: the look's."""
        with self._changed:
            view = self._views.setdefault(eye, View(camera, wish=0))
            view.camera, view.quality = camera, quality
            view.ask()
            self._changed.notify_all()

    def leave(self, eye: Hashable) -> None:
        """An eye is gone."""
        with self._changed:
            view = self._views.pop(eye, None)
            if view is not None:
                view.ask()
            self._changed.notify_all()

    def picture(self, eye: Hashable) -> tuple[RefinedPicture | None, bool]:
        """The last picture of an eye, and whether it shows what is wished for now."""
        with self._changed:
            view = self._views.get(eye)
            return (None, False) if view is None else (view.picture, view.shown > 0)

    def set(self, look: Look) -> None:
        """Show another look to all."""
        with self._changed:
            if look == self.look:
                return
            self.look = look
            for view in self._views.values():
                view.ask()
            self._changed.notify_all()

    def set_material(self, material: Material) -> None:
        """Show another material with the same parameters, once its texture is grown. Raises InputError for one with others."""
        now = self.begun.material
        if (material.kind, material.parameters) != (now.kind, now.parameters):
            raise InputError(material.name, f"has other parameters than {now.name}")
        with self._changed:
            self.begun, self._textures = replace(self.begun, material=material), (None, *self._textures[1:])
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

    def close(self) -> None:
        """End both threads."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _scene(self, view: View) -> Scene:
        return scene_of_look(self.begun, self.still, self.look, with_size(view.camera, self.look.side), self._lit)

    def say(self, of: str, line: str) -> None:
        """Say what is wrong with pictures, textures and scenes; an empty line once nothing is."""
        with self._telling:
            if self._faults[of] != line:
                self._faults[of] = line
                self._tell("  \n".join(x for x in self._faults.values() if x))

    def _next(self) -> tuple[Hashable, View] | None:
        """The eye whose turn it is: those that wait for their first pictures first, then each in turn. Waits for one; None at
        the end."""
        with self._changed:
            while self._open:
                waiting = [(eye, v) for eye, v in self._views.items() if v.waits]
                waiting = [(eye, v) for eye, v in waiting if v.urgent] or waiting
                now = time.monotonic()
                ready = [(eye, v) for eye, v in waiting if v.rest <= now]
                if ready:
                    self._turn += 1
                    eye, view = ready[self._turn % len(ready)]
                    if view.painted != view.wish:
                        view.painted = view.wish
                        own, quality = view.quality is None, view.quality or self.look.quality
                        changes = self.look.changes if own else {}
                        how = {"engine": self._engine, "coarse": own, "changes": changes}
                        view.left = refine(self._scene(view), quality, self._stopped(view), **how)
                    return eye, view
                self._changed.wait(min(v.rest for _, v in waiting) - now if waiting else None)
        return None

    def _stopped(self, view: View) -> Callable[[], bool]:
        wish = view.wish
        return lambda: view.wish != wish or not self._open

    def _paint(self) -> None:
        while (turn := self._next()) is not None:
            eye, view = turn
            assert view.left is not None
            try:
                with self._paint_lock:
                    picture = next(view.left, None)
                with self._changed:
                    if picture is None:
                        view.left = None
                        continue
                    if view.painted != view.wish:
                        continue
                    if view.quality is None and view.shown == 0:
                        view.rest = time.monotonic() + PAUSE
                    view.picture, view.shown = picture, view.shown + 1
                self.say("picture", "")
                self._show(eye)
            except Exception as fault:  # the page goes on, and says it
                view.left = None
                self.say("picture", _line(fault))

    def _grow(self) -> None:
        while self._open:
            with self._changed:
                while self._open and self.look.textures(self.begun) == self._textures:
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
                self.say("texture", _line(fault))
            else:
                self.say("texture", "")
            with self._changed:
                if self.begun is begun:
                    self._textures = wanted
                if made is not None:
                    self.still, self.given = made, replace(self.given, material=begun.material)
                for view in self._views.values():
                    view.ask()
                self._changed.notify_all()
            self._growing(1.0)


def _line(fault: Exception) -> str:
    return str(fault) if isinstance(fault, InputError) else f"{type(fault).__name__}: {fault}"
