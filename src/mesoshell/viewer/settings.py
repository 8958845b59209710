"""The settings of a viewer's picture: a preset, and each field of `Quality` that the picture depends on, with what a change
costs.

A pass has one ray or path a pixel and its density from the network, so fields about these are not here.
"""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from mesoshell.render.quality import PRESETS, SETTINGS, Quality, kind_of, out_of_range
from mesoshell.viewer.look import Look
from mesoshell.viewer.refine import RefinedPicture

SIDES = (128, 256, 384, 512, 768, 1024)
#: Fields that say nothing of a pass.
LEFT_OUT = ("pixel_samples", "spp", "density")
#: A whole number may be so many times the largest of a preset: a page takes any number that is typed.
MOST = 4
#: Views whose costs are kept: of several clients.
VIEWS = 4


class Cost(NamedTuple):
    """Of a pass: seconds, and evaluations of the network a ray."""

    seconds: float
    evaluations: float


class SettingsPanel:
    """Folders of a server's page. changed: called when something is set."""

    def __init__(self, gui: Any, engine: str, look: Look, changed: Callable[[Any], None]):
        self._changed, self._setting, self._lock = changed, False, threading.RLock()
        self._settings = look.settings
        self._views: deque[tuple[tuple, dict[Quality, Cost]]] = deque(maxlen=VIEWS)
        self._before: Quality | None = None
        with gui.add_folder("Picture"):
            self._preset = gui.add_dropdown("quality", tuple(PRESETS), initial_value=look.quality)
            hint = "of the longer side"
            self._side = gui.add_dropdown("pixels", tuple(map(str, SIDES)), initial_value=str(look.side), hint=hint)
            self.cost = gui.add_markdown("")
        with gui.add_folder("Settings", expand_by_default=False):
            self._said = gui.add_markdown("Change one, and see what it costs.")
            self._fields = {
                name: _control(gui, name, getattr(self._settings, name))
                for name, setting in SETTINGS.items()
                if setting.engine in ("", engine) and name not in LEFT_OUT
            }
        self._preset.on_update(self._reset)
        self._side.on_update(changed)
        for name, field in self._fields.items():
            field.on_update(partial(self._set, name))

    def look(self) -> dict[str, Any]:
        """Fields of a `Look`."""
        preset = PRESETS[self._preset.value]
        now = {name: getattr(self._settings, name) for name in self._fields}
        changes = {name: value for name, value in now.items() if value != getattr(preset, name)}
        return {"quality": self._preset.value, "side": int(self._side.value), "changes": changes}

    def see(self, picture: RefinedPicture, look: Look) -> None:
        """A picture has come: show the fields that it depends on, and what the last change costs."""
        if picture.samples >= 2:  # the first pass has the preparations in it, or is a coarse one
            with self._lock:
                self._see(picture, look)

    def _see(self, picture: RefinedPicture, look: Look) -> None:
        record = picture.rendered.record
        for name, field in self._fields.items():
            if field.visible != (name in record["quality"]):
                field.visible = name in record["quality"]
        # costs are compared where all else is alike
        about = picture.camera.to_world.tobytes(), picture.rgba.shape, replace(look, quality="", changes={})
        costs = next((costs for seen, costs in self._views if seen == about), None)
        if costs is None:
            costs = {}
            self._views.append((about, costs))
        costs[picture.settings] = Cost(picture.seconds, record["queries"] / max(record["rays"], 1))
        before, now = self._before, self._settings
        if before is not None and before in costs and picture.settings == now != before:
            self._say(_said(before, now, costs[before], costs[now]))

    def _say(self, text: str) -> None:
        if self._said.content != text:
            self._said.content = text

    def _show(self, settings: Quality) -> None:
        """In the controls."""
        self._setting = True
        for name, field in self._fields.items():
            field.value = getattr(settings, name)
        self._setting = False

    def _reset(self, event: Any) -> None:
        """Another preset: its values."""
        with self._lock:
            self._remember(PRESETS[self._preset.value])
        self._changed(event)

    def _set(self, name: str, event: Any) -> None:
        with self._lock:
            if self._setting or not self._take(name):
                return
        self._changed(event)

    def _take(self, name: str) -> bool:
        """Take a field's value; whether it can be."""
        try:
            value = kind_of(name)(self._fields[name].value)
        except (TypeError, ValueError, OverflowError):
            value = None
        fault = "is no number" if value is None else out_of_range(name, value)
        if not fault and isinstance(value, int) and not isinstance(value, bool) and value > _most(name):
            fault = f"must be at most {_most(name)} here"
        if fault:
            self._show(self._settings)
            self._before = None  # or the cost of a change before would be said again
            self._say(f"`{name}` {fault}")
            return False
        self._remember(self._settings.with_changes(**{name: value}))
        return True

    def _remember(self, settings: Quality) -> None:
        """What is set now, and what it is compared with: what was measured last."""
        if settings == self._settings:
            return
        if any(self._settings in costs for _, costs in self._views):
            self._before = self._settings
        self._settings = settings
        self._show(settings)
        self._say(f"{_what(self._before, settings)}: under way" if self._before not in (None, settings) else "")


def _control(gui: Any, name: str, value: Any) -> Any:
    """A field's control, unseen until a picture depends on it."""
    setting = SETTINGS[name]
    hint = setting.meaning + (
        f". Cheaper values bias {setting.bias}" if setting.bias else ". Cheaper values only add noise"
    )
    if setting.words:
        return gui.add_dropdown(name, setting.words, initial_value=value, hint=hint, visible=False)
    if kind_of(name) is bool:
        return gui.add_checkbox(name, value, hint=hint, visible=False)
    if kind_of(name) is int:
        most = _most(name)
        return gui.add_number(name, value, min=int(setting.least), max=most, step=1, hint=hint, visible=False)
    return gui.add_number(name, value, min=float(setting.least), step=0.001, hint=hint, visible=False)


def _most(name: str) -> int:
    return MOST * max(getattr(preset, name) for preset in PRESETS.values())


def _what(before: Any, after: Quality) -> str:
    """What has changed."""
    each = ((name, getattr(before, name), getattr(after, name)) for name in SETTINGS if name not in LEFT_OUT)
    return ", ".join(f"`{name}` {old} → {new}" for name, old, new in each if old != new)


def _said(before: Quality, after: Quality, old: Cost, new: Cost) -> str:
    """What a change costs."""
    each = f", {old.evaluations:.1f} → {new.evaluations:.1f} evaluations a ray" if old.evaluations else ""
    return f"{_what(before, after)}: {1000 * old.seconds:.0f} → {1000 * new.seconds:.0f} ms a pass{each}"
