"""Further materials of a scene, by the options that name them: NODE=MATERIAL, FILE=MATERIAL and MATERIAL:NAME=VALUE."""

from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import InputError
from mesoshell.scene.materials import Material, load_material
from mesoshell.scene.scene import Grown

#: What `--param MATERIAL:NAME=VALUE` sets beside parameters, and its kind.
PROPORTIONS = {"thickness": float, "scale": float, "seed": int}


class Named(NamedTuple):
    """Fields of a Scene."""

    grow: tuple[str, ...]
    objects: tuple[Path, ...]
    params: dict[str, str]
    also: tuple[Grown, ...]


def grown_of(options: SceneOptions) -> Named:
    """What the options name. Raises InputError."""
    nodes: dict[str, list[str]] = {}
    files: list[tuple[Path, str]] = []
    own, bare = [], []
    for text in options.grow:
        node, _, material = text.rpartition("=")
        if node and material:
            nodes.setdefault(material, []).append(node)
        else:
            own.append(text)
    for path in options.object:
        file, _, material = str(path).rpartition("=")
        if file and material and not path.exists():
            files.append((Path(file), material))
        else:
            bare.append(path)
    names = dict.fromkeys([*nodes, *(material for _, material in files)])
    params, given = _split(options, names)
    loaded: dict[str, Material] = {name: load_material(name) for name in names}
    also = [Grown(loaded[name], grow=tuple(some), **given[name]) for name, some in nodes.items()]
    also += [Grown(loaded[name], file, **given[name]) for file, name in files]
    return Named(tuple(own), tuple(bare), params, tuple(also))


def _split(options: SceneOptions, names: dict[str, None]) -> tuple[dict[str, str], dict[str, dict[str, Any]]]:
    """Values of the scene's own material, and fields of a Grown for each further one."""
    params: dict[str, str] = {}
    given: dict[str, dict[str, Any]] = {name: {"params": {}} for name in names}
    for key, value in pairs_of("--param", options.param).items():
        material, _, name = key.rpartition(":")
        if not material:
            params[key] = value
        elif material not in given:
            grown = f"these are {', '.join(names)}" if names else "there is none"
            raise InputError("--param", f"{key}: {material} is not among the further materials: {grown}")
        elif name in PROPORTIONS:
            given[material][name] = _number(key, value, PROPORTIONS[name])
        else:
            given[material]["params"][name] = value
    return params, given


def _number(key: str, value: str, kind: type) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise InputError("--param", f"{key}={value} is no {'whole ' * (kind is int)}number") from None
