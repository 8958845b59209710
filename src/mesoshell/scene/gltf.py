"""What a glTF file says beside its meshes: its camera, and the lights of KHR_lights_punctual (no JAX).

Notation
node        of the file's scene, with a transform from its parent's frame: a matrix by columns, or a translation, a quaternion
            x y z w and a scale. A camera looks along its node's −z with y up, a light shines along −z
lux         what the extension measures a sun's illuminance in: 683 of them are a W/m², as exporters reckon it; and so many
            candela of a point or a spot a W/sr

Sources: glTF 2.0, sections 3.5 and 3.10; KHR_lights_punctual.
"""

import json
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.render.lamp import Lamp
from mesoshell.scene.file_scene import FileScene, frame_of, lamp_fault, sun_of

LUX = 683.0
LIGHTS, INSTANCES = "KHR_lights_punctual", "EXT_mesh_gpu_instancing"
#: W/m² below which it is said that suns are faint.
FAINT = 0.05


def read_file_scene(path: str | PathLike[str]) -> FileScene:
    """What a glTF file says. Raises ValueError and its like if it is damaged there."""
    return _file_scene(header_of(Path(path)))


def header_of(path: Path) -> dict[str, Any]:
    """The JSON of a file."""
    with path.open("rb") as file:
        if path.suffix.lower() == ".glb":
            start = file.read(20)
            return json.loads(file.read(int.from_bytes(start[12:16], "little")))
        return json.load(file)


def _file_scene(header: dict[str, Any]) -> FileScene:
    cameras, suns, lamps, others, notes = [], [], [], [], []
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
                cameras.append((name, (frame_of(to_world), fov), None if aspect is None else float(aspect)))
            else:
                notes.append(f"its camera {name} is no perspective one: left out")
        light = node.get("extensions", {}).get(LIGHTS)
        if light is not None:
            light = lights[light["light"]]
            strength = np.array(light.get("color", (1, 1, 1)), np.float64) * float(light.get("intensity", 1.0)) / LUX
            name = str(node.get("name", light["type"]))
            if light["type"] == "directional":
                suns.append(sun_of(to_world, strength))
            elif light["type"] not in ("point", "spot"):
                others.append(name)
            elif np.linalg.det(to_world[:3, :3]) != 0 and strength.any():  # else hidden by its scale, or dark
                cone = light.get("spot", {})
                angles = float(cone.get("innerConeAngle", 0.0)), float(cone.get("outerConeAngle", np.pi / 4))
                lamp = Lamp(light["type"], to_world, strength, angles if light["type"] == "spot" else (0.0, 0.0))
                fault = lamp_fault(lamp)
                lamps += [] if fault else [lamp]
                notes += [f"its lamp {name} is left out: {fault}"] if fault else []
    if len(cameras) > 1:
        notes.append(f"it has {len(cameras)} cameras: {cameras[0][0]}, the first, is taken")
    if suns and max(sun.irradiance.max() for sun in suns) < FAINT:
        notes.append(
            "its suns are so faint that they may be in W/m², and not in lux: export them with lighting mode Standard"
        )
    if others:
        notes.append(f"its lights of other kinds are left out: {', '.join(others)}")
    notes += [f"its {what}" for what in _unread(header)]
    _, camera, aspect = cameras[0] if cameras else ("", None, None)
    return FileScene(camera, aspect, tuple(suns), tuple(notes), lamps=tuple(lamps))


def _unread(header: dict[str, Any]) -> list[str]:
    """What moves or repeats meshes in a file, and is not read."""
    nodes, meshes = header.get("nodes", []), header.get("meshes", [])
    found = {
        "skins move nothing": any("skin" in node for node in nodes),
        "morph targets move nothing": any(any(x.get("weights", ())) for x in (*nodes, *meshes)),
        f"instances ({INSTANCES}) are read as one mesh": any(INSTANCES in node.get("extensions", {}) for node in nodes),
    }
    return [what for what, there in found.items() if there]


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
