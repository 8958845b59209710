"""Materials of a scene, by the options that name them: NODE=MATERIAL, FILE=MATERIAL and WHAT:NAME=VALUE; and by its file.

WHAT is a material, for all meshes that have it; or a node, or a file by its stem, for that one alone. A file whose stem names
something else too is WHAT as it was given; several nodes of one material are one mesh, unless WHAT is one of them.

Where no option says what the scene's own material is, or where it grows, each node of the file that names its material itself
(scene/worn) is a NODE=MATERIAL too, unless an option names that node; and the first of these in the file is the scene's own, or
the first of the options' if all are named by options.
"""

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import InputError
from mesoshell.io.material import parameter_vector
from mesoshell.io.surface import KIND
from mesoshell.scene.materials import Material, load_material, read_params
from mesoshell.scene.scene import Grown
from mesoshell.scene.unpack import is_scene_file
from mesoshell.scene.worn import Says, Worn, read_worn

#: What grows where neither an option nor the scene's file says.
DEFAULT = "grass"
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
    """Fields of a Scene, and notes; told: what its file says of its own material, by PROPORTIONS."""

    material: Material
    grow: tuple[str, ...]
    objects: tuple[Path, ...]
    params: dict[str, Any]
    also: tuple[Grown, ...]
    told: dict[str, Any]
    notes: tuple[str, ...] = ()


def grown_of(options: SceneOptions, material: Material | None = None) -> Named:
    """What the options and the scene's file name. material: in the place of the option's. Raises InputError."""
    if material is None and options.material is not None:
        material = load_material(options.material)
    loaded = {} if material is None else {material.name: material}
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
    says = Says()
    if material is None and not own and is_scene_file(options.mesh):
        says = read_worn(options.mesh, {node for some in nodes.values() for node in some})
    for x in says.worn:
        nodes.setdefault(x.material, []).append(x.node)
        loaded[x.material] = loaded.get(x.material) or _loaded(x, options.mesh)
    materials = dict.fromkeys([*nodes, *(name for _, name in files)])
    known = [node for some in nodes.values() for node in some if node not in materials]
    stems = Counter([*materials, *known, *(file.stem for file, _ in files)])
    called = [file.stem if stems[file.stem] == 1 else str(file) for file, _ in files]
    params, given = _split(options, dict.fromkeys([*materials, *known, *called]))
    told = {x.node: _told(x, loaded[x.material], options.mesh) for x in says.worn if x.values}
    also = []
    for name, some in nodes.items():
        apart = [node for node in some if node in told or (node in known and node in given)]  # with values of their own
        together = tuple(node for node in some if node not in apart)
        if together:
            alone = together[0] if len(together) == 1 and together[0] in known else None
            also.append(_grown(None, loaded[name], given, grow=together, name=alone))
        also += [_grown(None, loaded[name], given, told.get(node), grow=(node,), name=node) for node in apart]
    for (file, name), of in zip(files, called, strict=True):
        also.append(_grown(file, loaded[name], given, name=of))
    if says.names:
        first = also.pop(_first(also, [x.node for x in says.worn], options.mesh, says.notes))
        fields = {name: getattr(first, name) for name in PROPORTIONS}
        params = {**first.params, **params}
        return Named(first.material, tuple(first.grow), tuple(bare), params, tuple(also), fields, says.notes)
    material = material or loaded.get(DEFAULT) or load_material(DEFAULT)
    return Named(material, tuple(own), tuple(bare), params, tuple(also), {})


def _first(also: Sequence[Grown], nodes: Sequence[str], mesh: Path, notes: Sequence[str]) -> int:
    """Which of some meshes is the scene's own: the first shell, in the order of nodes, then in their own."""
    shells = [k for k, x in enumerate(also) if x.mesh is None and x.material.kind != KIND]
    others = [k for k, x in enumerate(also) if x.mesh is None]
    if not others:
        raise InputError(mesh, f"{'; '.join(notes)}: --material or --grow names what grows")
    named = (k for node in nodes for k in shells if node in also[k].grow)
    return next(named, (shells or others)[0])


def _loaded(worn: Worn, mesh: Path) -> Material:
    try:
        return load_material(worn.material)
    except InputError as fault:
        raise InputError(mesh, f"{worn.node}: {fault}") from fault


def _told(worn: Worn, material: Material, mesh: Path) -> dict[str, Any]:
    """A node's own values, as fields of a Grown. Raises InputError for what its material does not have."""
    told: dict[str, Any] = {"params": {}}
    for key, value in worn.values.items():
        _put(told, str(mesh), worn.node, key, value)
    for key in (key for key in told["params"] if key not in material.parameters):
        has = ", ".join([*material.parameters, *PROPORTIONS])
        raise InputError(mesh, f"{worn.node}: {worn.material} has no {key!r}; it has {has}")
    for key in ("scale", "thickness"):
        if not 0 < told.get(key, 1.0) < float("inf"):
            raise InputError(mesh, f"{worn.node}: {key} must be above 0, not {told[key]:g}")
    try:
        if told["params"]:
            numbers, _ = read_params(material.shell, told["params"])
            parameter_vector(material.shell, numbers)
    except InputError as fault:
        raise InputError(mesh, f"{worn.node}: {fault.fault}") from fault
    return told


def _grown(
    mesh: Path | None,
    material: Material,
    given: Mapping[str, dict[str, Any]],
    told: Mapping[str, Any] | None = None,
    **named: Any,
) -> Grown:
    """With what is given for its material, what its file says of it, and what is given for itself by its name."""
    one = Grown(mesh, material, **named)
    fields: dict[str, Any] = {"params": {}}
    own = {} if one.called == material.name else given.get(one.called, {})
    for of in (given.get(material.name, {}), told or {}, own):
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
            _put(fields, "--param", name, key, value)
    params = pairs_of("--param", own)
    for key in params:
        if ":" in key:
            grown = f"these are {', '.join(names)}" if names else "there is none"
            raise InputError("--param", f"{key}: {key.rpartition(':')[0]} is not among the further materials: {grown}")
    return params, given


def _put(fields: dict[str, Any], source: str, name: str, key: str, value: str) -> None:
    """A value among the fields of what is called `name`. Raises InputError about its source."""
    if (key, value) == ("growth", NO_GROWTH_IMAGE):
        fields[key] = None
    elif key in PROPORTIONS:
        kind, wanted = PROPORTIONS[key]
        try:
            fields[key] = kind(value)
        except ValueError:
            raise InputError(source, f"{name}:{key} must be {wanted}, not {value}") from None
    else:
        fields["params"][key] = value
