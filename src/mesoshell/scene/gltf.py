"""What a glTF file says beside its meshes: its camera, and the suns of KHR_lights_punctual (no JAX).

Notation
node        of the file's scene, with a transform from its parent's frame: a matrix by columns, or a translation, a quaternion
            x y z w and a scale. A camera looks along its node's −z with y up, a light shines along −z
lux         what the extension measures a sun's illuminance in: 683 of them are a W/m², as exporters reckon it

Sources: glTF 2.0, sections 3.5 and 3.10; KHR_lights_punctual.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import FARTHEST, load_nodes
from mesoshell.limits import check_memory
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant
from mesoshell.scene.kept_meshes import kept_mesh
from mesoshell.scene.scene import Scene

FORMATS, LUX = (".glb", ".gltf"), 683.0
LIGHTS = "KHR_lights_punctual"
#: Share by which a picture's proportions may differ from the camera's before it is said.
ALIKE = 0.01
#: W/m² below which it is said that suns are faint.
FAINT = 0.05


@dataclass(frozen=True)
class Told:
    """camera: its frame and vertical field of view, radians, or None; aspect: width over height that it was made for, or None;
    suns; notes: what the user should know, a line each."""

    camera: tuple[Float[np.ndarray, "4 4"], float] | None
    aspect: float | None
    suns: tuple[Distant, ...]
    notes: tuple[str, ...]


def is_gltf(mesh: Any) -> bool:
    """Whether it is the path of a glTF file."""
    return isinstance(mesh, str | PathLike) and Path(mesh).suffix.lower() in FORMATS


def unpacked(scene: Scene) -> Scene:
    """The scene with what its glTF file says in the place of defaults, and `grow` taken apart; any other scene as it is. Raises
    InputError."""
    named = [x for x in scene.also if x.mesh is None]
    if not is_gltf(scene.mesh):
        if scene.grow or named:
            raise InputError(Argument("grow"), "names meshes of a glTF file, and the scene has none")
        return scene
    assert isinstance(scene.mesh, str | PathLike)
    if scene.grow or named:
        (mesh, *meshes), others = load_nodes(scene.mesh, [scene.grow, *(x.grow for x in named)])
    else:
        mesh, meshes, others = kept_mesh(scene.mesh), [], ()
    own = iter(meshes)
    told = read_told(scene.mesh)
    notes, camera, lights = list(told.notes), scene.camera, scene.lights
    if camera is None and told.camera is not None and _is_size(scene.size):
        width, height = scene.size
        check_memory(Argument("size"), f"a picture of {width} x {height}", 64 * width * height)
        camera = Camera(*told.camera, width, height)
        if told.aspect is not None and abs(width / height / told.aspect - 1) > ALIKE:
            notes.append(
                f"its camera is {told.aspect:.3g} times as wide as high: --size {width} {round(width / told.aspect)}"
            )
    if not lights and scene.suns:
        lights = told.suns
    return replace(
        scene,
        mesh=replace(mesh, notes=(*mesh.notes, *notes)),
        camera=camera,
        lights=lights,
        objects=(*scene.objects, *others),
        grow=(),
        also=tuple(replace(x, mesh=next(own), grow=()) if x.mesh is None else x for x in scene.also),
        up=scene.up or "y",
    )


def _is_size(size: Any) -> bool:
    """Whether a picture can have it; else what checks sizes says so."""
    return (
        len(size) == 2 and all(isinstance(n, int) and n > 0 for n in size) if isinstance(size, tuple | list) else False
    )


def read_told(path: str | PathLike[str]) -> Told:
    """What a glTF file says. Raises InputError if it is damaged there."""
    try:
        return _told(_header(Path(path)))
    except (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as fault:
        raise InputError(path, f"its cameras or lights cannot be read: {fault!r}") from fault


def _header(path: Path) -> dict[str, Any]:
    """The JSON of a file."""
    with path.open("rb") as file:
        if path.suffix.lower() == ".glb":
            start = file.read(20)
            return json.loads(file.read(int.from_bytes(start[12:16], "little")))
        return json.load(file)


def _told(header: dict[str, Any]) -> Told:
    cameras, suns, others, notes = [], [], [], []
    lights = header.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
    for node, to_world in _nodes(header):
        if "camera" in node:
            camera = header["cameras"][node["camera"]]
            name = str(node.get("name", camera.get("name", "a camera")))
            if camera["type"] == "perspective":
                lens = camera["perspective"]
                fov, aspect = float(lens["yfov"]), lens.get("aspectRatio")
                if not 0 < fov < np.pi or (aspect is not None and not 1e-3 < float(aspect) < 1e3):
                    raise ValueError(f"{name} sees {fov:g} radians, {aspect} times as wide as high")
                cameras.append((name, (_frame(to_world), fov), None if aspect is None else float(aspect)))
            else:
                notes.append(f"its camera {name} is no perspective one: left out")
        light = node.get("extensions", {}).get(LIGHTS)
        if light is not None:
            light = lights[light["light"]]
            if light["type"] == "directional":
                colour = np.array(light.get("color", (1, 1, 1)), np.float64)
                suns.append(_sun(to_world, colour * float(light.get("intensity", 1.0)) / LUX))
                if not (
                    suns[-1].irradiance.shape == (3,)
                    and ((suns[-1].irradiance >= 0) & (suns[-1].irradiance < 1e30)).all()
                ):
                    raise ValueError(
                        f"a sun has the strength {light.get('intensity')} and the colour {colour.tolist()}"
                    )
            else:
                others.append(str(node.get("name", light["type"])))
    if len(cameras) > 1:
        notes.append(f"it has {len(cameras)} cameras: {cameras[0][0]}, the first, is taken")
    if suns and max(sun.irradiance.max() for sun in suns) < FAINT:
        notes.append(
            "its suns are so faint that they may be in W/m², and not in lux: export them with lighting mode Standard"
        )
    if others:
        notes.append(f"its lights that are no suns are left out: {', '.join(others)}")
    _, camera, aspect = cameras[0] if cameras else ("", None, None)
    return Told(camera, aspect, tuple(suns), tuple(notes))


def _nodes(header: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Float[np.ndarray, "4 4"]]]:
    """Each node of the file's scene once, parents first, and its frame in the world."""
    nodes, scenes = header.get("nodes", []), header.get("scenes", [])
    roots = scenes[header.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting, seen = [(k, np.eye(4)) for k in reversed(roots)], set()
    while waiting:
        k, parent = waiting.pop()
        if k in seen:
            continue
        seen.add(k)
        to_world = parent @ _transform(nodes[k])
        yield nodes[k], to_world
        waiting += [(child, to_world) for child in reversed(nodes[k].get("children", []))]


def _transform(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64) / max(
        np.linalg.norm(node.get("rotation", (0, 0, 0, 1))), 1e-30
    )
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
    out[:3, 3] = node.get("translation", (0, 0, 0))
    return out


def _frame(to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """A camera's frame without its node's scale: right, up, back, where it stands."""
    if not np.abs(to_world).max() <= FARTHEST:
        raise ValueError("a camera's transform holds a number that is not finite, or too large")
    back, up = _unit(to_world[:3, 2]), to_world[:3, 1]
    right = _unit(np.cross(up, back))
    out = np.eye(4)
    out[:3] = np.stack([right, np.cross(back, right), back, to_world[:3, 3]], axis=1)
    return out


def _sun(to_world: Float[np.ndarray, "4 4"], irradiance: Float[np.ndarray, "3"]) -> Distant:
    return Distant(_unit(to_world[:3, 2]), irradiance)


def _unit(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = float(np.linalg.norm(v))
    if not 0 < length < np.inf:
        raise ValueError("a camera or a light has no direction")
    return v / length
