"""Take a scene's file apart, if it describes more than a mesh: a glTF file or a USD stage (no JAX)."""

from dataclasses import replace
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.geometry import read_usd
from mesoshell.geometry.mesh import Mesh, bounding_box, load_nodes
from mesoshell.geometry.read import file_of
from mesoshell.limits import check_memory
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import Lamp, as_distant
from mesoshell.scene import gltf, usd
from mesoshell.scene.file_scene import FileScene
from mesoshell.scene.kept_meshes import kept_mesh
from mesoshell.scene.scene import Scene

#: What reads each format.
READERS = {
    ".glb": gltf.read_file_scene,
    ".gltf": gltf.read_file_scene,
    **dict.fromkeys(read_usd.FORMATS, usd.read_file_scene),
}
#: Radiance below which a sky without suns is said to be faint.
FAINT = 0.1
#: Irradiance below which lamps that light a scene alone are said to be faint.
DIM = 0.05
#: Share by which a picture's proportions may differ from the camera's before it is said.
ALIKE = 0.01


def is_scene_file(mesh: Any) -> bool:
    """Whether it is the path of a file that may say more than a mesh."""
    return isinstance(mesh, str | PathLike) and file_of(mesh).suffix.lower() in READERS


def read_scene_file(path: str | PathLike[str]) -> FileScene:
    """What such a file says. Raises InputError if it is damaged there."""
    try:
        return READERS[Path(path).suffix.lower()](path)
    except InputError:
        raise
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        MemoryError,
        OSError,
        RecursionError,
        TypeError,
        ValueError,
    ) as fault:
        raise InputError(path, f"its cameras or lights cannot be read: {fault!r}") from fault


def unpack(scene: Scene) -> Scene:
    """The scene with what its file says in the place of defaults, and `grow` taken apart; any other scene as it is. Raises
    InputError."""
    if scene.up not in (None, "y", "z"):
        raise InputError(Argument("up"), f"must be y or z, not {scene.up}")
    named = [x for x in scene.also if x.mesh is None]
    if not is_scene_file(scene.mesh):
        if scene.grow or named:
            raise InputError(Argument("grow"), "names meshes of a glTF file or a USD stage, and the scene has none")
        return scene
    assert isinstance(scene.mesh, str | PathLike)
    path = file_of(scene.mesh)
    if scene.grow or named:
        (mesh, *meshes), others = load_nodes(path, [scene.grow, *(x.grow for x in named)])
    else:
        mesh, meshes, others = kept_mesh(path), [], ()
    own = iter(meshes)
    inside = read_scene_file(path)
    notes, camera, sky = list(inside.notes), scene.camera, scene.environment
    lights, lamps = scene.lights, scene.lamps
    if camera is None and inside.camera is not None and _is_size(scene.size):
        width, height = scene.size
        check_memory(Argument("size"), f"a picture of {width} x {height}", 64 * width * height)
        camera = Camera(*inside.camera, width, height)
        if inside.aspect is not None and abs(width / height / inside.aspect - 1) > ALIKE:
            notes.append(
                f"its camera is {inside.aspect:.3g} times as wide as high: --size {width} {round(width / inside.aspect)}"
            )
    if not lights and not lamps and scene.suns:
        lights, lamps = inside.suns, inside.lamps
        if sky is None and inside.sky is not None:
            try:
                sky = inside.sky.radiance(scene.up or inside.up)
            except InputError as fault:
                notes.append(f"its sky is left out: {fault}")
            if sky is not None and not lights and not lamps and sky.max() < FAINT:
                notes.append("its sky is faint, and it has no sun: --light or --no-suns lights it otherwise")
    dim = lamps is inside.lamps and bool(lamps) and sum(_brightness(lamp, mesh) for lamp in lamps) < DIM
    if dim and not lights and sky is None:
        notes.append(
            "its lamps are faint on the mesh, and nothing else lights it: --light or --no-suns lights it otherwise"
        )
    return replace(
        scene,
        mesh=replace(mesh, notes=(*mesh.notes, *notes)),
        camera=camera,
        lights=lights,
        lamps=lamps,
        environment=sky,
        objects=(*scene.objects, *others),
        grow=(),
        also=tuple(replace(x, mesh=next(own), grow=()) if x.mesh is None else x for x in scene.also),
        up=scene.up or inside.up,
    )


def _brightness(lamp: Lamp, mesh: Mesh) -> float:
    low, high = bounding_box(mesh).astype(np.float64)
    return float(as_distant(lamp, (low + high)[None] / 2).irradiance.max())


def _is_size(size: Any) -> bool:
    """Whether a picture can have it; else what checks sizes says so."""
    return (
        len(size) == 2 and all(isinstance(n, Integral) and int(n) > 0 for n in size)
        if isinstance(size, tuple | list)
        else False
    )
