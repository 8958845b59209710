"""What a viewer does beside its page: one thread paints, another grows textures; the newest wish counts.

Notation
view        what one eye sees: its camera, and a number that grows with each wish. A client has an eye, or several to compare
"""

import threading
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
from mesoshell.scene.settled import settled
from mesoshell.scene.setup import check_irradiance, describe_shell, describe_surface
from mesoshell.viewer.look import Look, described, first_look, shown, sized, with_texture_of
from mesoshell.viewer.refine import Abandoned, Shown, refine


@dataclass
class View:
    """camera: of any size with its proportions; quality: None for the look's; wish: its number; painted: that of the picture
    under way; left: its steps."""

    camera: Camera
    quality: str | None = None
    wish: int = 1
    painted: int = 0
    left: Iterator[Shown] | None = None


class Workshop:
    """Paints what eyes see of a scene. show: called with an eye and a picture; say: with a line for all, empty when a
    fault is over; growing: with the share of a texture that is grown, 1 at the end. Callbacks come from threads of its own."""

    def __init__(
        self,
        scene: Scene,
        show: Callable[[Any, Shown], None],
        say: Callable[[str], None],
        growing: Callable[[float], None],
        engine: str = "jax",
        progress: Callable[[float], None] = lambda share: None,
        hand: AbstractContextManager | None = None,
    ):
        """Settles the scene. hand: which workshops that paint in turn share. Raises InputError."""
        self.given, self._lit = scene, bool(scene.lights) or scene.environment is not None
        check_irradiance("irradiance", np.array(scene.irradiance, np.float64))
        if scene.material.kind == KIND:
            describe_surface(scene)  # raises what a picture of it would
        self.begun = settled(scene, texture=False)
        self.still = settled(self.begun, progress)
        if scene.material.kind != KIND:
            describe_shell(self.still)  # once its texture is grown
        self.look = first_look(self.begun)
        self._texture: tuple | None = self.look.texture(self.begun)
        self._show, self._tell, self._growing, self._engine = show, say, growing, engine
        self._faults = {"picture": "", "texture": "", "scene": "", "environment": "", "snapshot": "", "run": ""}
        self._views: dict[Hashable, View] = {}
        self._changed, self._open, self._turn = threading.Condition(), True, 0
        self._hand = hand or threading.Lock()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._paint, self._grow)]
        for thread in self._threads:
            thread.start()

    def see(self, eye: Hashable, camera: Camera, quality: str | None = None) -> None:
        """An eye looks from here. quality: of its pictures alone, which have no coarse one before; None: the look's."""
        with self._changed:
            view = self._views.setdefault(eye, View(camera, wish=0))
            view.camera, view.quality, view.wish = camera, quality, view.wish + 1
            self._changed.notify_all()

    def leave(self, eye: Hashable) -> None:
        """An eye is gone."""
        with self._changed:
            view = self._views.pop(eye, None)
            if view is not None:
                view.wish += 1
            self._changed.notify_all()

    def set(self, look: Look) -> bool:
        """Show a look to all; whether it is another one."""
        with self._changed:
            if look == self.look:
                return False
            self.look = look
            for view in self._views.values():
                view.wish += 1
            self._changed.notify_all()
            return True

    def wear(self, material: Material) -> None:
        """Show another material with the same parameters, once its texture is grown."""
        with self._changed:
            self.given, self.begun = replace(self.given, material=material), replace(self.begun, material=material)
            self._texture = None
            self._changed.notify_all()

    def scene(self, eye: Hashable) -> Scene:
        """What an eye sees now."""
        with self._changed:
            return self._scene(self._views[eye])

    def described(self, eye: Hashable) -> Scene:
        """What an eye sees, as it could be given: with parameters in place of a grown texture."""
        with self._changed:
            camera = sized(self._views[eye].camera, self.look.side)
            return described(self.begun, self.look, camera, self._lit)

    def close(self) -> None:
        """End both threads."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _scene(self, view: View) -> Scene:
        return shown(self.begun, self.still, self.look, sized(view.camera, self.look.side), self._lit)

    def say(self, of: str, line: str) -> None:
        """Say what is wrong with pictures, textures and scenes; an empty line once nothing is."""
        if self._faults[of] != line:
            self._faults[of] = line
            self._tell("  \n".join(x for x in self._faults.values() if x))

    def _next(self) -> tuple[Hashable, View] | None:
        """The eye whose turn it is: those that wait for a coarse picture first, then each in turn. Waits for one; None at the
        end."""
        with self._changed:
            while self._open:
                views = self._views.items()
                coarse = [(eye, v) for eye, v in views if v.painted != v.wish and v.quality is None]
                unfinished = coarse or [(eye, v) for eye, v in views if v.painted != v.wish or v.left is not None]
                if unfinished:
                    self._turn += 1
                    eye, view = unfinished[self._turn % len(unfinished)]
                    if view.painted != view.wish:
                        view.painted = view.wish
                        quality, coarse = view.quality or self.look.quality, view.quality is None
                        view.left = refine(self._scene(view), quality, self._stopped(view), self._engine, coarse)
                    return eye, view
                self._changed.wait()
        return None

    def _stopped(self, view: View) -> Callable[[], bool]:
        wish = view.wish
        return lambda: view.wish != wish or not self._open

    def _paint(self) -> None:
        while (turn := self._next()) is not None:
            eye, view = turn
            assert view.left is not None
            try:
                with self._hand:
                    picture = next(view.left, None)
                if picture is None:
                    view.left = None
                elif view.painted == view.wish:
                    self.say("picture", "")
                    self._show(eye, picture)
            except Exception as fault:  # the page goes on, and says it
                view.left = None
                self.say("picture", _line(fault))

    def _grow(self) -> None:
        while self._open:
            with self._changed:
                while self._open and self.look.texture(self.begun) == self._texture:
                    self._changed.wait()
                look, begun = self.look, self.begun
            if not self._open:
                return
            wanted = look.texture(begun)

            def check(share: float, wanted: tuple = wanted, begun: Scene = begun) -> None:
                if not self._open or self.begun is not begun or self.look.texture(begun) != wanted:
                    raise Abandoned
                self._growing(share)

            still = None
            try:
                still = settled(with_texture_of(begun, look), check)
            except Abandoned:
                self._growing(1.0)
                continue
            except Exception as fault:
                self.say("texture", _line(fault))
            else:
                self.say("texture", "")
            with self._changed:
                if self.begun is begun:
                    self._texture = wanted
                if still is not None:
                    self.still = still
                for view in self._views.values():
                    view.wish += 1
                self._changed.notify_all()
            self._growing(1.0)


def _line(fault: Exception) -> str:
    return str(fault) if isinstance(fault, InputError) else f"{type(fault).__name__}: {fault}"
