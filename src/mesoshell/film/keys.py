"""Keys: values of camera and parameters at some frames, and all between them.

    {"keys": [{"frame": 0, "camera": [0, 1, 3, 0, 0, 0, 35], "params": {"age": 0}},
              {"frame": 47, "params": {"age": 1}, "thickness": 0.1}]}

Notation
track       the keys that give one number, in order of frames; before its first key and after its last it stays

A further material's parameter or thickness is NAME:PARAMETER among `params`. NAME is what `Grown.called` says; or its
material, for all that have it, but for those that the same parameter is given by their own names.

Between keys a track is a monotone cubic (Fritsch and Carlson 1980): smooth, and never beyond the keys around it, so that a
parameter stays in its range. The film ends with the last key.
"""

from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from mesoshell.errors import Argument, InputError
from mesoshell.film.motion import Motion, check_count
from mesoshell.geometry.mesh import FARTHEST
from mesoshell.io.material import parameter_vector
from mesoshell.io.records import read_object
from mesoshell.io.surface import KIND
from mesoshell.scene.scene import Grown, Scene

#: Numbers of a key beside its frame: camera is eye, target and vertical field of view in degrees, as of a Scene.
CAMERA, NUMBERS = 7, ("thickness",)
Keys = Sequence[Any]


def read_keys(path: str | PathLike[str]) -> list[dict[str, Any]]:
    """The keys in a JSON file. Raises InputError, which names the file."""
    read = read_object(Path(path))
    if list(read) != ["keys"] or not isinstance(read["keys"], list):
        raise InputError(path, 'must be {"keys": [...]}')
    try:
        _check(read["keys"])
    except InputError as fault:
        raise InputError(path, str(fault).partition(": ")[2]) from fault
    return read["keys"]


def follow(keys: Keys, scene: Scene) -> Motion:
    """The motion through keys. Raises InputError for keys that are none, for a parameter that the material has not, or one that
    is out of its range."""
    _check(keys)
    count = keys[-1]["frame"] + 1
    check_count("keys", count)
    tracks = {name: track for name in ("camera", *NUMBERS) if (track := _track(keys, lambda key, n=name: key.get(n)))}
    names = _by_part(scene, dict.fromkeys(name for key in keys for name in key.get("params", {})))
    params = {
        part: {own: _track(keys, lambda key, n=name: key.get("params", {}).get(n)) for own, name in given.items()}
        for part, given in names.items()
    }
    _check_params(scene, keys, names)
    parts = (scene, *scene.also)
    shape = [k for k, given in names.items() if any(_is_geometry(parts[k], name) for name in given)]

    def change(k: int) -> dict[str, Any]:
        at: dict[str, Any] = {name: track(k) for name, track in tracks.items()}
        changed: dict[str, Any] = {
            name: value.tolist() if name == "camera" else float(value) for name, value in at.items()
        }
        for part, some in params.items():
            values = {name: float(track(k)) for name, track in some.items()}
            if part == 0:
                changed["params"] = values
                continue
            own: dict[str, Any] = {name: values.pop(name) for name in NUMBERS if name in values}
            changed.setdefault("also", {})[part - 1] = own | ({"params": values} if values else {})
        return changed

    return Motion(count, change, shape)


def _by_part(scene: Scene, names: Collection[str]) -> dict[int, dict[str, str]]:
    """Which of the keys' names gives which of a material's own, by material: 0 is the scene's, 1 and on are those of `also`.
    Raises InputError for a name that no material has."""
    found, aliases = {}, [("",), *((part.material.name, part.called) for part in scene.also)]  # the last counts
    for k, some in enumerate(aliases):
        given = {name.rpartition(":")[2]: name for alias in some for name in names if name.rpartition(":")[0] == alias}
        if given:
            found[k] = given
    for name in names:
        of = name.rpartition(":")[0]
        if not any(of in some for some in aliases):
            called = ", ".join(dict.fromkeys(part.called for part in scene.also)) or "there is none"
            raise InputError(Argument("keys"), f"{name}: {of} is not among the further materials: {called}")
    return found


def _is_geometry(part: Scene | Grown, name: str) -> bool:
    return name in part.material.parameters and part.material.parameters[name].role == "beta"


def _check_params(scene: Scene, keys: Keys, names: Mapping[int, Mapping[str, str]]) -> None:
    """Raise InputError for what a material has not, a value out of its range, or geometry that it cannot change."""
    if scene.material.kind == KIND:
        if names or any(name in key for key in keys for name in NUMBERS):
            raise InputError(Argument("keys"), f"{scene.material.name} is a surface material: it has only a camera")
        return
    parts = (scene, *scene.also)
    for k, given in names.items():
        if parts[k].material.kind == KIND:
            fault = (
                f"{next(iter(given.values()))}: {parts[k].material.name} is a surface material: it has no parameters"
            )
            raise InputError(Argument("keys"), fault)
        bundle = parts[k].material.shell
        for key in keys:
            values = {own: float(key["params"][name]) for own, name in given.items() if name in key.get("params", {})}
            numbers = {name: values.pop(name) for name in NUMBERS if k and name in values}
            wrong = [given[name] for name, x in numbers.items() if not x > 0]
            if wrong:
                raise InputError(Argument("keys"), f"{wrong[0]} must be a positive number")
            try:
                parameter_vector(bundle, values)
            except InputError as fault:
                of = f"{scene.also[k - 1].called}: " if k else ""
                raise InputError(Argument("keys"), of + fault.fault) from fault
        fixed = [given[own] for own in given if _is_geometry(parts[k], own) and bundle.generator is None]
        if fixed:
            raise InputError(
                Argument("keys"), f"{fixed[0]} is baked into {parts[k].material.name}, which has no generator"
            )


def _track(keys: Keys, value: Any) -> Any:
    """A function of the frame; None if no key gives a value."""
    frames = [key["frame"] for key in keys if value(key) is not None]
    values = [np.asarray(value(key), np.float64) for key in keys if value(key) is not None]
    if not frames:
        return None
    if len(frames) == 1:
        return lambda k: values[0]
    with np.errstate(over="ignore"):  # of slopes that are no normal numbers
        between = PchipInterpolator(frames, values)
    return lambda k: between(min(max(k, frames[0]), frames[-1]))


def _check(keys: Keys) -> None:
    """Raise InputError unless these are keys."""
    last = -1
    if not keys:
        raise InputError(Argument("keys"), "must hold at least one key")
    for i, key in enumerate(keys):
        fault = _fault(key, last)
        if fault:
            raise InputError(Argument("keys"), f"key {i}: {fault}")
        last = key["frame"]


def _fault(key: Any, last: int) -> str:
    if not isinstance(key, Mapping):
        return "must be an object"
    unknown = sorted(set(key) - {"frame", "camera", "params", *NUMBERS})
    if unknown:
        return f"unknown field '{unknown[0]}': there are frame, camera, params, {', '.join(NUMBERS)}"
    frame = key.get("frame")
    if type(frame) is not int or frame <= last:
        return f"frame must be a whole number above {last}, not {frame!r}"
    camera = key.get("camera")
    if camera is not None and not (
        isinstance(camera, Sequence) and len(camera) == CAMERA and all(map(_number, camera))
    ):
        return "camera must be 7 numbers: eye, target and field of view in degrees"
    if camera is not None and not (0 < camera[6] < 180 and list(camera[:3]) != list(camera[3:6])):
        return "camera must have its eye apart from its target, and a field of view between 0 and 180 degrees"
    if camera is not None and max(map(abs, camera)) > FARTHEST:
        return f"camera holds a number beyond {FARTHEST:g}"
    params = key.get("params", {})
    if not isinstance(params, Mapping) or not all(map(_number, params.values())):
        return "params must give numbers by name"
    wrong = [name for name in NUMBERS if name in key and not (_number(key[name]) and key[name] > 0)]
    return f"{wrong[0]} must be a positive number" if wrong else ""


def _number(x: Any) -> bool:
    return type(x) in (int, float) and -1e300 < x < 1e300
