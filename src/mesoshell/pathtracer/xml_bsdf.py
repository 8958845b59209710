"""Mitsuba scenes with shells: a `mesoshell` BSDF on a mesh describes its shell; the rest of the scene is unchanged.

    <shape type="obj"> <string name="filename" value="spot.obj"/>
        <bsdf type="mesoshell"> <string name="material" value="grass"/> <float name="age" value="0.3"/>
            <bsdf type="diffuse"/> </bsdf> </shape>

material: a bundled name or a .npz file; thickness, scale (world; defaults as of `mesoshell render`) and seed; any other number
or texture is a parameter of the material; the BSDF within is the surface's own.

Between parsing a scene and making its objects, each such node is replaced by the BSDF within it. A shell on a mesh of a shape
group stands on each of its instances.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.shell.geometry.extrude import EARTH

NAME = "mesoshell"
_NUMBERS = ("thickness", "scale", "seed")


@dataclass(frozen=True, eq=False)
class Element:
    """One `mesoshell` BSDF of a scene. where: in the file; shape: its mesh; placed: to-world matrices of its instances, None if
    the shape has its own; flipped: Mitsuba's v is 1 minus the file's, as of OBJ files; numbers, textures: by the names of
    parameters; is_surface_material: its shape is taken out of the scene."""

    where: str
    material: str
    shape: mi.Mesh
    thickness: float | None = None
    scale: float | None = None
    seed: int | None = None
    numbers: dict[str, float] = field(default_factory=dict)
    textures: dict[str, mi.Texture] = field(default_factory=dict)
    placed: tuple[Float[np.ndarray, "4 4"], ...] | None = None
    flipped: bool = False
    is_surface_material: bool = False


def read(
    source: str,
    parse: Callable[[Any], Any],
    is_surface_material: Callable[[str], bool],
    size: tuple[int, int] | None = None,
) -> tuple[mi.Scene, list[Element]]:
    """The scene without its shells, and their elements. parse: configuration to the parser's state; is_surface_material: of a
    material, which then replaces its shape; size: of its film, None: its own. Raises InputError."""
    config = mi.parser.ParserConfig(str(mi.variant()))
    config.merge_equivalent = config.merge_meshes = False
    try:
        state = parse(config)
        mi.parser.transform_all(config, state)
        if size is not None:
            _resize(source, state, size)
        nodes = [(i, mi.Properties(n.props)) for i, n in enumerate(state.nodes) if n.props.plugin_name() == NAME]
        users = {i: _users(state, i) for i, _ in nodes}
        for i, props in nodes:
            _replace(state, i, props)
        if nodes:
            _integrate(state)
        elements = [_element(config, state, i, props, shape) for i, props in nodes for shape in users[i]]
        shapes = [shape for i, _ in nodes for shape in users[i]]
        elements = [replace(e, is_surface_material=_is_surface_material(e, is_surface_material)) for e in elements]
        _remove(state, {shape for shape, e in zip(shapes, elements, strict=True) if e.is_surface_material})
        scene: Any = mi.parser.instantiate(config, state)
        return scene, elements
    except RuntimeError as error:
        raise InputError(source, " ".join(str(error).split())) from error


def _resize(source: str, state, size: tuple[int, int]) -> None:
    """Give every film a width and a height. Raises InputError if there is none, or one is cropped."""
    films = [node for node in state.nodes if node.type == mi.ObjectType.Film]
    if not films:
        raise InputError(source, "has no film that a size could be given to")
    for node in films:
        if {"crop_width", "crop_height"} & {*node.props.keys()}:
            raise InputError(mi.parser.file_location(state, node), "a film that is cropped keeps its own size")
        node.props["width"], node.props["height"] = size


def _links(props: mi.Properties) -> dict[str, int]:
    """Nodes that a node refers to, by its names for them."""
    return {k: v.index() for k, v in props.items() if isinstance(v, mi.Properties.ResolvedReference)}


def _users(state, index: int) -> list[int]:
    """The shapes with this node as their BSDF."""
    shapes = []
    for i, node in enumerate(state.nodes):
        if index in _links(node.props).values() and node.type != mi.ObjectType.Scene:
            if node.type != mi.ObjectType.Shape:
                where = mi.parser.file_location(state, state.nodes[index])
                raise InputError(
                    where, f"a {NAME} BSDF within a '{node.props.plugin_name()}': it must belong to a shape directly"
                )
            shapes.append(i)
    return shapes


def _replace(state, index: int, props: mi.Properties) -> None:
    """Replace the node by the BSDF within it, or by bare earth."""
    inner = [i for i in _links(props).values() if state.nodes[i].type == mi.ObjectType.BSDF]
    where = mi.parser.file_location(state, state.nodes[index])
    if len(inner) > 1:
        raise InputError(where, f"{len(inner)} BSDFs within a {NAME} BSDF: a surface has one")
    if inner:
        state.nodes[index].props = mi.Properties(state.nodes[inner[0]].props)
    else:
        bare = mi.Properties("diffuse")
        bare["reflectance"] = mi.ScalarColor3d(*EARTH)
        state.nodes[index].props = bare


def _is_surface_material(element: Element, is_surface_material: Callable[[str], bool]) -> bool:
    try:
        return is_surface_material(element.material)
    except InputError as error:
        raise InputError(element.where, str(error)) from error


def _remove(state, shapes: set[int]) -> None:
    """Remove shapes from the scene and from groups; remove groups left empty, with their instances."""
    kinds = [node.props.plugin_name() for node in state.nodes]
    groups = {i: _holds(state, i) for i, kind in enumerate(kinds) if kind == "shapegroup"}
    empty = {i for i, held in groups.items() if held and held <= shapes}
    gone = shapes | empty | {i for i, kind in enumerate(kinds) if kind == "instance" and _holds(state, i) & empty}
    for node in state.nodes:
        for name in [k for k, index in _links(node.props).items() if index in gone]:
            del node.props[name]


def _holds(state, index: int) -> set[int]:
    """Shapes that a node refers to."""
    return {i for i in _links(state.nodes[index].props).values() if state.nodes[i].type == mi.ObjectType.Shape}


def _integrate(state) -> None:
    """Replace the integrator `path` by one that also traces paths through shells."""
    for node in state.nodes:
        name = node.props.plugin_name()
        if node.type == mi.ObjectType.Integrator or name == "mesoshell_path":  # whose type a dict does not tell
            if name not in ("path", "mesoshell_path"):
                where = mi.parser.file_location(state, node)
                raise InputError(where, f"integrator '{name}' does not support shells: use path")
            node.props.set_plugin_name("mesoshell_path")
            return
    node = mi.parser.SceneNode()
    node.type, node.props = mi.ObjectType.Integrator, mi.Properties("mesoshell_path")
    state.nodes.append(node)
    state.nodes[0].props["mesoshell_path"] = mi.Properties.ResolvedReference(len(state.nodes) - 1)


def _element(config, state, index: int, props: mi.Properties, shape: int) -> Element:
    where = mi.parser.file_location(state, state.nodes[index])
    own: dict[str, Any] = {}
    numbers: dict[str, Any] = {}
    textures: dict[str, mi.Texture] = {}
    for key, value in props.items():
        if isinstance(value, mi.Properties.ResolvedReference):
            if state.nodes[value.index()].type == mi.ObjectType.Texture:
                textures[key] = _made(config, state, value.index())
        elif key in _NUMBERS:
            own[key] = value
        elif key != "material":
            numbers[key] = value if isinstance(value, bool) or not isinstance(value, int) else float(value)
    wrong = [k for k, v in (own | numbers).items() if isinstance(v, bool) or not isinstance(v, int | float)]
    if wrong:
        raise InputError(where, f"{wrong[0]} must be a number or a texture")
    if not isinstance(props.get("material"), str):
        raise InputError(where, "names no material: give a bundled one's name, or a .npz file")
    mesh = _made(config, state, shape)
    if not isinstance(mesh, mi.Mesh):
        raise InputError(
            where, f"a '{state.nodes[shape].props.plugin_name()}' is not a mesh: shells stand on triangles"
        )
    own = {k: int(v) if k == "seed" else float(v) for k, v in own.items()}
    plugin = state.nodes[shape].props
    return Element(
        where,
        str(props["material"]),
        mesh,
        **own,
        numbers=numbers,
        textures=textures,
        placed=_placed(state, shape),
        flipped=bool(plugin.get("flip_tex_coords", plugin.plugin_name() == "obj")),
    )


def _made(config, state, index: int) -> Any:
    """Instantiate one node alone."""
    alone = mi.parser.ParserState(state)
    alone.nodes[0] = mi.parser.SceneNode(alone.nodes[index])
    return mi.parser.instantiate(config, alone)


def _placed(state, shape: int) -> tuple[np.ndarray, ...] | None:
    """To-world matrices of the instances of the shape group that a shape belongs to; None for one of no group."""
    kinds = [n.props.plugin_name() for n in state.nodes]
    holds = [set(_links(n.props).values()) for n in state.nodes]
    groups = {i for i, kind in enumerate(kinds) if kind == "shapegroup" and shape in holds[i]}
    if not groups:
        return None
    instances = [state.nodes[i].props for i, kind in enumerate(kinds) if kind == "instance" and groups & holds[i]]
    return tuple(np.array(p["to_world"].matrix) if "to_world" in p else np.eye(4) for p in instances)
