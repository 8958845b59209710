"""Nodes of a scene's file that name the materials that grow on them (no JAX).

Notation
mesoshell:material      attribute of a node: the name, or the file beside the scene's, of the material that grows on it
mesoshell:NAME          any other: a value of that material, as `--param NODE:NAME` sets it

Of a glTF file these are in the `extras` of nodes and materials, of a USD stage attributes of prims, as Blender writes custom
properties of its objects and materials. A USD attribute without a value is none.
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from os import PathLike
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple

from mesoshell.errors import InputError
from mesoshell.geometry.read import file_of, names_of_parts
from mesoshell.geometry.read_usd import FORMATS, MAX_PRIMS, open_stage, pxr
from mesoshell.io.archive import MANIFEST
from mesoshell.scene.gltf import header_of

OURS = "mesoshell:"


class Worn(NamedTuple):
    """A node that names a material. node: as `Scene.grow` takes it; values: as `--param` takes them."""

    node: str
    material: str
    values: dict[str, str]


class Says(NamedTuple):
    """What a file says of materials. worn: by nodes that are seen; names: whether any node names one; notes: on the others."""

    worn: tuple[Worn, ...] = ()
    names: bool = False
    notes: tuple[str, ...] = ()


def read_worn(path: str | PathLike[str], but: Collection[str]) -> Says:
    """The nodes of a glTF file or a USD stage that name materials. but: names, or paths of prims, of nodes that are left out.
    Raises InputError."""
    file, found = file_of(path), []
    with suppress(InputError):  # of a file that cannot be read: what reads its meshes says so
        found = list((_of_stage if file.suffix.lower() in FORMATS else _of_gltf)(file))
    every: dict[str, Mapping[str, Any]] = {}
    for node, attributes in found:
        ours = {name.removeprefix(OURS): x for name, x in attributes.items() if name.startswith(OURS) and x is not None}
        if node not in but and every.setdefault(node, ours) != ours and node:
            raise InputError(path, f"{node}: several nodes or materials have this name, and attributes that differ")
    left_out = {node for node in every if node.startswith("/") and node.rpartition("/")[2] in but}
    said = {node: ours for node, ours in every.items() if ours and node not in left_out}
    if not said:
        return Says(names=bool(left_out) or any(node in but for node, attributes in found if _is_ours(attributes)))
    used = {next((x for x in names if x in said or x in but), None) for names in names_of_parts(file)}
    idle = [node or "a node without a name" for node in said if node not in used or not node]
    notes = (f"nothing is seen of what {', '.join(idle[:5])}{' and more' * (len(idle) > 5)} would grow on",)
    worn = (_worn(node, x, path, file.parent) for node, x in said.items() if node and node in used)
    return Says(tuple(worn), True, notes if idle else ())


def _is_ours(attributes: Mapping[str, Any]) -> bool:
    return any(name.startswith(OURS) for name in attributes)


def _worn(node: str, ours: Mapping[str, Any], path: str | PathLike[str], folder: Path) -> Worn:
    texts = {name: _text(value, folder) for name, value in ours.items()}
    for name, text in texts.items():
        if text is None:
            raise InputError(path, f"{node}: {OURS}{name} is neither a text nor a number: {ours[name]!r}")
    if not isinstance(ours.get("material"), str):
        others = ", ".join(f"{OURS}{name}" for name in ours if name != "material")
        fault = f"{OURS}material is no text" if "material" in ours else f"has {others}, and no {OURS}material"
        raise InputError(path, f"{node}: {fault}")
    return Worn(node, texts.pop("material") or "", {name: text for name, text in texts.items() if text is not None})


def _text(value: Any, folder: Path) -> str | None:
    """A value as an option has it, a file or a material's folder with the folder that it lies in; None if it has none."""
    if isinstance(value, str):
        beside = folder / value
        return (str(beside) if isfile(beside) or isfile(beside / MANIFEST) else value) or None
    if isinstance(value, int | float):
        whole = not isinstance(value, int) and value.is_integer()  # as programs write a seed
        return None if isinstance(value, bool) else repr(int(value) if whole else value)
    numbers = list(value) if hasattr(value, "__len__") and not isinstance(value, Mapping) else []
    texts = [_text(x, folder) for x in numbers if not isinstance(x, str)]
    return ",".join(x for x in texts if x) if texts and None not in texts and len(texts) == len(numbers) else None


def _of_gltf(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Names and extras of a file's nodes, then of its materials. Raises InputError for a damaged one."""
    try:
        header = header_of(path)
        nodes = [(str(x.get("name", f"node {k}")), x.get("extras")) for k, x in enumerate(header.get("nodes", []))]
        every = [*nodes, *((str(x.get("name", "")), x.get("extras")) for x in header.get("materials", []))]
    except (AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError) as fault:
        raise InputError(path, f"its nodes cannot be read: {fault!r}") from fault
    yield from ((name, extras if isinstance(extras, Mapping) else {}) for name, extras in every)


def _of_stage(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Paths and attributes of a stage's prims, also of those that are repeated. Raises InputError for a damaged one."""
    with open_stage(path) as (stage, time):
        Usd = pxr("Usd")
        for count, prim in enumerate(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())):
            if count > MAX_PRIMS:
                raise InputError(path, f"it has more than {MAX_PRIMS} prims")
            ours = prim.GetAuthoredPropertiesInNamespace(OURS.rstrip(":"))
            given = {x.GetName(): x.Get(time) for x in ours if hasattr(x, "Get")}  # a relationship has no value
            if given:
                yield (
                    str(prim.GetPath()),
                    {k: getattr(x, "resolvedPath", "") or getattr(x, "path", x) for k, x in given.items()},
                )
