"""The settings of a viewer's picture: a preset, and each field of `Quality` that the picture depends on, with what a change
costs.

A pass has one ray or path a pixel and its density from the network, so fields about these are not here.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from mesoshell.render.quality import PRESETS, SETTINGS, kind_of, out_of_range
from mesoshell.viewer.look import Look
from mesoshell.viewer.refine import RefinedPicture

SIDES = (128, 256, 384, 512, 768, 1024)
#: Fields that say nothing of a pass.
LEFT_OUT = ("pixel_samples", "spp", "density")
#: A whole number may be so many times the largest of a preset: a page takes any number that is typed.
MOST = 4


class SettingsPanel:
    """Folders of a server's page. changed: called when something is set."""

    def __init__(self, gui: Any, engine: str, look: Look, changed: Callable[[Any], None]):
        self._changed, self._resetting = changed, False
        self._passes: dict[tuple, tuple[float, float]] = {}
        self._last: tuple[dict[str, Any], dict[str, Any]] | None = None
        with gui.add_folder("Picture"):
            self._preset = gui.add_dropdown("quality", tuple(PRESETS), initial_value=look.quality)
            hint = "of the longer side"
            self._side = gui.add_dropdown("pixels", tuple(map(str, SIDES)), initial_value=str(look.side), hint=hint)
            self.cost = gui.add_markdown("")
        with gui.add_folder("Settings", expand_by_default=False) as self._folder:
            self._said = gui.add_markdown("Change one, and see what it costs.")
            preset = PRESETS[look.quality]
            self._fields = {
                name: _control(gui, name, getattr(preset, name))
                for name, setting in SETTINGS.items()
                if setting.engine in ("", engine) and name not in LEFT_OUT
            }
        self._settings = {**preset.as_dict(), **look.changes}
        self._preset.on_update(self._reset)
        self._side.on_update(changed)
        for name, field in self._fields.items():
            field.on_update(partial(self._set, name))

    @property
    def preset(self) -> str:
        return self._preset.value

    def look(self) -> dict[str, Any]:
        """Fields of a `Look`."""
        preset = PRESETS[self.preset].as_dict()
        changes = {name: self._settings[name] for name in self._fields if self._settings[name] != preset[name]}
        return {"quality": self.preset, "side": int(self._side.value), "changes": changes}

    def see(self, picture: RefinedPicture, look: Look) -> None:
        """A picture has come: show the fields that it depends on, and what the last change costs."""
        used = picture.rendered.record["quality"]
        for name, field in self._fields.items():
            if field.visible != (name in used):
                field.visible = name in used
        if picture.samples < 2:
            return  # the first pass has the preparations in it, or is a coarse one
        size = picture.rgba.shape[:2]
        now = look.settings.as_dict()
        self._passes[_key(now, size)] = picture.seconds, _evaluations(picture)
        if self._last is not None and now == self._last[1]:
            costs = [self._passes.get(_key(x, size)) for x in self._last]
            if None not in costs:
                text = _said(self._last[0], self._last[1], *costs)  # type: ignore[arg-type]
                if self._said.content != text:
                    self._said.content = text

    def _reset(self, event: Any) -> None:
        """Another preset: its values."""
        self._resetting = True
        for name, field in self._fields.items():
            field.value = getattr(PRESETS[self.preset], name)
        self._resetting = False
        self._remember(PRESETS[self.preset].as_dict())
        self._changed(event)

    def _set(self, name: str, event: Any) -> None:
        if self._resetting:
            return
        try:
            value = kind_of(name)(self._fields[name].value)
        except (TypeError, ValueError, OverflowError):
            return
        if isinstance(value, int) and not isinstance(value, bool):
            value = min(value, _most(name))
        if out_of_range(name, value):
            self._said.content = f"`{name}` {out_of_range(name, value)}"
            return
        self._remember({**self._settings, name: value})
        self._changed(event)

    def _remember(self, settings: dict[str, Any]) -> None:
        if settings != self._settings:
            self._last = self._settings, settings
            self._settings = settings
            self._said.content = f"{_what(*self._last)}: under way"


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


def _what(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What has changed."""
    return ", ".join(f"`{name}` {before[name]} → {after[name]}" for name in after if before[name] != after[name])


def _key(settings: Mapping[str, Any], size: tuple[int, ...]) -> tuple:
    return *sorted(settings.items()), size


def _evaluations(picture: RefinedPicture) -> float:
    record = picture.rendered.record
    return record["queries"] / max(record["rays"], 1)


def _said(
    before: Mapping[str, Any], after: Mapping[str, Any], old: tuple[float, float], new: tuple[float, float]
) -> str:
    """What a change costs. old, new: seconds of a pass, and evaluations a ray."""
    each = f", {old[1]:.1f} → {new[1]:.1f} evaluations a ray" if old[1] or new[1] else ""
    return f"{_what(before, after)}: {1000 * old[0]:.0f} → {1000 * new[0]:.0f} ms a pass{each}"
