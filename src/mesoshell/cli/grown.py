"""Materials of a scene, by the options that name them: NODE=MATERIAL, FILE=MATERIAL and WHAT:NAME=VALUE; and by its file.

WHAT is a material, for all meshes that have it; or a node, or a file by its stem, for that one alone. A file whose stem names
something else too is WHAT as it was given; several nodes of one material are one mesh, unless WHAT is one of them.

A node of the file that names its material itself (scene/file_scene) is a NODE=MATERIAL, unless an option names that node. Then
the first NODE=MATERIAL, of options before the file's, is the scene's own if no option says which that is.
"""

import os
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.cli.checks import pairs_of
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import InputError
from mesoshell.geometry.read import file_of
from mesoshell.io.surface import KIND
from mesoshell.scene.file_scene import Worn
from mesoshell.scene.materials import Material, load_material
from mesoshell.scene.scene import Grown
from mesoshell.scene.unpack import is_scene_file, read_scene_file

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
    """Fields of a Scene; told: what its file says of its own material, by PROPORTIONS."""

    material: Material
    grow: tuple[str, ...]
    objects: tuple[Path, ...]
    params: dict[str, Any]
    also: tuple[Grown, ...]
    told: dict[str, Any]


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
    worn = _worn(options.mesh, {*own, *(node for some in nodes.values() for node in some)}, loaded)
    for x in worn:
        nodes.setdefault(x.material, []).append(x.node)
    materials = dict.fromkeys([*nodes, *(name for _, name in files)])
    known = [node for some in nodes.values() for node in some if node not in materials]
    stems = Counter([*materials, *known, *(file.stem for file, _ in files)])
    called = [file.stem if stems[file.stem] == 1 else str(file) for file, _ in files]
    params, given = _split(options, dict.fromkeys([*materials, *known, *called]))
    told = {x.node: _told(x, loaded[x.material], options.mesh) for x in worn if x.values}
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
    if worn and material is None and not own:
        shells = [k for k, x in enumerate(also) if x.mesh is None and x.material.kind != KIND]
        first = also.pop(min(shells, default=0))
        fields = {name: getattr(first, name) for name in PROPORTIONS}
        return Named(first.material, tuple(first.grow), tuple(bare), {**first.params, **params}, tuple(also), fields)
    material = material or loaded.get(DEFAULT) or load_material(DEFAULT)
    return Named(material, tuple(own), tuple(bare), params, tuple(also), {})


def _worn(mesh: Path, named: set[str], loaded: dict[str, Material]) -> list[Worn]:
    """The nodes of a scene's file that name their materials, which are loaded. named: by options, as prims may be by their path
    or their name: they are left out."""
    worn: list[Worn] = []
    with suppress(InputError):  # of a file that cannot be read: what reads its meshes says so
        inside = read_scene_file(file_of(mesh)).worn if is_scene_file(mesh) else ()
        worn = [x for x in inside if not named & {x.node, x.node.rpartition("/")[2] if x.node[0] == "/" else x.node}]
    for node, name, _ in worn:
        try:
            loaded[name] = loaded.get(name) or load_material(name)
        except InputError as fault:
            raise InputError(mesh, f"{node}: {fault}") from fault
    return worn


def _told(worn: Worn, material: Material, mesh: Path) -> dict[str, Any]:
    """A node's own values, as fields of a Grown. Raises InputError for what its material does not have."""
    told: dict[str, Any] = {"params": {}}
    for key, value in worn.values.items():
        _put(told, str(mesh), worn.node, key, value)
    for key in (key for key in told["params"] if key not in material.parameters):
        has = ", ".join([*material.parameters, *PROPORTIONS])
        raise InputError(mesh, f"{worn.node}: {worn.material} has no {key!r}; it has {has}")
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
