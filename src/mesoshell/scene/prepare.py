"""Make a scene ready for an engine. Only that engine is imported."""

import time
from collections.abc import Mapping
from typing import Any

from mesoshell.errors import Argument, InputError
from mesoshell.io.surface import KIND
from mesoshell.render.quality import PRESETS, Quality, out_of_range, unknown, wrong_kind
from mesoshell.scene.picture import Prepared, Progress
from mesoshell.scene.scene import Scene

ENGINES = ("jax", "mitsuba")
#: Fields of a quality that only the path tracer uses, and the greatest value of each.
PATH_FIELDS, MAX_PATHS = ("spp", "max_depth"), 2**24
#: Fields that a scene of Mitsuba's fixes itself.
FIXED_BY_XML = ("max_depth", "rr_depth")


def quality_of(quality: str | Quality, engine: str, changes: Mapping[str, Any]) -> Quality:
    """A quality, or the preset of this name, with changes of its fields. Raises InputError for an unknown name or field, an
    invalid value, or a field that the engine does not use."""
    if engine not in ENGINES:
        raise InputError(Argument("engine"), f"must be one of {', '.join(ENGINES)}, not {engine}")
    if isinstance(quality, str) and quality not in PRESETS:
        raise InputError(Argument("quality"), f"must be a Quality or one of {', '.join(PRESETS)}, not {quality}")
    for name, value in changes.items():
        _check_field(name, value, engine)
    if not isinstance(quality, str | Quality):
        raise InputError(Argument("quality"), f"must be a Quality or one of {', '.join(PRESETS)}, not {quality!r}")
    begun = PRESETS[quality] if isinstance(quality, str) else quality
    return begun.with_changes(**changes)


def _check_field(name: str, value: Any, engine: str) -> None:
    if fault := unknown(name) or wrong_kind(name, value):
        raise InputError(Argument(name), fault)
    if fault := out_of_range(name, value):
        raise InputError(Argument(name), f"{fault}, not {value}")
    if name in PATH_FIELDS:
        if engine != "mitsuba":
            raise InputError(Argument(name), "requires `engine` mitsuba")
        if value > MAX_PATHS:
            raise InputError(Argument(name), f"must be at most {MAX_PATHS}, not {value}")


def check_engine(scene: Scene, engine: str) -> None:
    """Raise InputError for what a scene asks of an engine that has it not."""
    if scene.holdout and engine != "jax":
        raise InputError(Argument("holdout"), "objects are held out by `engine` jax alone")
    surface = next((part for part in scene.also if part.material.kind == KIND), None)
    if surface is not None and engine != "mitsuba":
        fault = f"{surface.material.name} is a surface material: beside a shell it requires `engine` mitsuba"
        raise InputError(Argument("also"), fault)


def prepare(scene: Scene, quality: Quality, engine: str = "jax", progress: Progress = lambda share: None) -> Prepared:
    """The scene, ready to be rendered: its effects are decided, nothing is compiled yet. progress: of growing a texture. Raises
    InputError."""
    begun = time.perf_counter()
    check_engine(scene, engine)
    if engine == "mitsuba":
        from mesoshell.scene.render_paths import prepare_paths as prepared_by
    elif scene.material.kind == KIND:
        from mesoshell.scene.render_surface import prepare_surface as prepared_by
    else:
        from mesoshell.scene.render_shell import prepare_shell as prepared_by
    return prepared_by(scene, quality, begun, progress)
