"""Further materials of a scene, by the options that name them: NODE=MATERIAL, FILE=MATERIAL and MATERIAL:NAME=VALUE."""

import os
from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import InputError
from mesoshell.scene.materials import Material, load_material
from mesoshell.scene.scene import Grown

#: What `--param MATERIAL:NAME=VALUE` sets beside parameters, and its kind.
PROPORTIONS = {"thickness": float, "scale": float, "seed": int, "growth": str}


class Named(NamedTuple):
    """Fields of a Scene."""

    grow: tuple[str, ...]
    objects: tuple[Path, ...]
    params: dict[str, str]
    also: tuple[Grown, ...]


def grown_of(options: SceneOptions, material: Material) -> Named:
    """What the options name. material: the scene's own. Raises InputError."""
    loaded = {material.name: material}
    nodes: dict[str, list[str]] = {}
    files: list[tuple[Path, str]] = []
    own, bare = [], []
    for text in options.grow:
        node, name = _apart(text, loaded)
        if name is None:
            own.append(node)
        else:
            nodes.setdefault(name, []).append(node)
    for path in options.object:
        file, name = (str(path), None) if os.path.exists(path) else _apart(str(path), loaded)
        if name is None:
            bare.append(path)
        else:
            files.append((Path(file), name))
    params, given = _split(options, dict.fromkeys([*nodes, *(name for _, name in files)]))
    also = [Grown(None, loaded[name], grow=tuple(some), **given[name]) for name, some in nodes.items()]
    also += [Grown(file, loaded[name], **given[name]) for file, name in files]
    return Named(tuple(own), tuple(bare), params, tuple(also))


def _apart(text: str, loaded: dict[str, Material]) -> tuple[str, str | None]:
    """NODE and MATERIAL of NODE=MATERIAL, which both may hold a =; the material is loaded. None: no material is named."""
    at = [k for k, c in enumerate(text) if c == "=" and 0 < k < len(text) - 1]
    for k in at:
        name = text[k + 1 :]
        if name not in loaded:
            try:
                loaded[name] = load_material(name)
            except InputError:
                if k == at[-1]:
                    raise
                continue
        return text[:k], name
    return text, None


def _split(options: SceneOptions, names: dict[str, None]) -> tuple[dict[str, str], dict[str, dict[str, Any]]]:
    """Values of the scene's own material, and fields of a Grown for each further one."""
    own: list[str] = []
    given: dict[str, dict[str, Any]] = {name: {"params": {}} for name in names}
    for text in options.param:
        name = next((name for name in names if text.startswith(f"{name}:")), None)
        if name is None:
            own.append(text)
            continue
        for key, value in pairs_of("--param", [text[len(name) + 1 :]]).items():
            if key in PROPORTIONS:
                given[name][key] = _number(f"{name}:{key}", value, PROPORTIONS[key])
            else:
                given[name]["params"][key] = value
    params = pairs_of("--param", own)
    for key in params:
        if ":" in key:
            grown = f"these are {', '.join(names)}" if names else "there is none"
            raise InputError("--param", f"{key}: {key.rpartition(':')[0]} is not among the further materials: {grown}")
    return params, given


def _number(key: str, value: str, kind: type) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise InputError("--param", f"{key}={value} is no {'whole ' * (kind is int)}number") from None
