"""Further materials of a scene, by the options that name them: NODE=MATERIAL, FILE=MATERIAL and WHAT:NAME=VALUE.

WHAT is a material, for all meshes that have it; or a node, or a file by its stem, for that one alone. A file whose stem names
something else too is WHAT as it was given; several nodes of one material are one mesh, unless WHAT is one of them.
"""

import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import InputError
from mesoshell.scene.materials import Material, load_material
from mesoshell.scene.scene import Grown

#: In the place of an image of growth: as high everywhere.
NO_GROWTH_IMAGE = "none"


def _latent(text: str) -> tuple[int, float]:
    """SEED,SHARE."""
    seed, share = text.split(",")
    return int(seed), float(share)


#: What `--param WHAT:NAME=VALUE` sets beside parameters, and what that must be.
PROPORTIONS: dict[str, tuple[Callable[[str], Any], str]] = {
    "thickness": (float, "a number"),
    "scale": (float, "a number"),
    "seed": (int, "a whole number"),
    "growth": (str, "a file"),
    "latent": (_latent, "SEED,SHARE, as 8,0.5"),
}


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
    materials = dict.fromkeys([*nodes, *(name for _, name in files)])
    known = [node for some in nodes.values() for node in some if node not in materials]
    stems = Counter([*materials, *known, *(file.stem for file, _ in files)])
    called = [file.stem if stems[file.stem] == 1 else str(file) for file, _ in files]
    params, given = _split(options, dict.fromkeys([*materials, *known, *called]))
    also = []
    for name, some in nodes.items():
        apart = [node for node in some if node in known and node in given]  # with values of their own
        together = tuple(node for node in some if node not in apart)
        if together:
            alone = together[0] if len(together) == 1 and together[0] in known else None
            also.append(_grown(None, loaded[name], given, grow=together, name=alone))
        also += [_grown(None, loaded[name], given, grow=(node,), name=node) for node in apart]
    for (file, name), of in zip(files, called, strict=True):
        also.append(_grown(file, loaded[name], given, name=of))
    return Named(tuple(own), tuple(bare), params, tuple(also))


def _grown(mesh: Path | None, material: Material, given: Mapping[str, dict[str, Any]], **named: Any) -> Grown:
    """With what is given for its material, and for itself by its name."""
    one = Grown(mesh, material, **named)
    fields: dict[str, Any] = {"params": {}}
    for name in dict.fromkeys((material.name, one.called)):
        of = given.get(name, {})
        fields |= {**of, "params": {**fields["params"], **of.get("params", {})}}
    return replace(one, **fields)


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
    """Values of the scene's own material, and fields of a Grown by the names that values are given for."""
    own: list[str] = []
    given: dict[str, dict[str, Any]] = {}
    for text in options.param:
        name = max((name for name in names if text.startswith(f"{name}:")), key=len, default=None)
        if name is None:
            own.append(text)
            continue
        fields = given.setdefault(name, {"params": {}})
        for key, value in pairs_of("--param", [text[len(name) + 1 :]]).items():
            if (key, value) == ("growth", NO_GROWTH_IMAGE):
                fields[key] = None
            elif key in PROPORTIONS:
                fields[key] = _read(f"{name}:{key}", value, *PROPORTIONS[key])
            else:
                fields["params"][key] = value
    params = pairs_of("--param", own)
    for key in params:
        if ":" in key:
            grown = f"these are {', '.join(names)}" if names else "there is none"
            raise InputError("--param", f"{key}: {key.rpartition(':')[0]} is not among the further materials: {grown}")
    return params, given


def _read(key: str, value: str, kind: Callable[[str], Any], wanted: str) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise InputError("--param", f"{key} must be {wanted}, not {value}") from None
