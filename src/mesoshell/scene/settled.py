"""Settle a scene: read its files and grow its texture once, for many pictures of it (loads JAX only to grow a texture)."""

from dataclasses import replace

import numpy as np

from mesoshell.geometry.mesh import bounding_box
from mesoshell.io.image import read_exr
from mesoshell.io.surface import KIND
from mesoshell.scene.gltf import unpacked
from mesoshell.scene.materials import Material, read_params
from mesoshell.scene.picture import Progress
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import camera_of, describe_shell, grows, lights_of, mesh_of, up_axis
from mesoshell.shell.geometry.extrude import proportions


def settled(scene: Scene, progress: Progress = lambda share: None, texture: bool = True) -> Scene:
    """The same scene with what its files hold, and its defaults, in place; its picture is the same, and lights stay where they
    are when its camera moves. progress: of growing the texture. texture: whether to grow it. Raises InputError."""
    scene = unpacked(scene)
    mesh, up, surface = mesh_of(scene.mesh), up_axis(scene), scene.material.kind == KIND
    thickness, scale = (
        (0.0, scene.scale)
        if surface
        else proportions(mesh, scene.material.shell.thickness, scene.thickness, scene.scale)
    )
    camera = camera_of(scene, bounding_box(mesh), thickness, up)
    sky, params = scene.environment, dict(scene.params)
    if not surface:
        numbers, images = read_params(scene.material.shell, scene.params)
        params = {**numbers, **images}
    still = replace(
        scene,
        mesh=mesh,
        thickness=None if surface else thickness,
        scale=scale,
        params=params,
        size=(camera.width, camera.height),
        camera=camera,
        lights=lights_of(scene, camera, up)[0],
        environment=sky if sky is None or isinstance(sky, np.ndarray) else read_exr(sky)[..., :3],
        objects=tuple(mesh_of(x) for x in scene.objects),
        up="y" if up == 1 else "z",
    )
    if surface or not (texture and grows(scene)):
        return still
    grown = Material(scene.material.name, describe_shell(still, progress).material)
    shape = {p.name for p in scene.material.shell.parameters if p.role == "beta"}
    return replace(still, material=grown, params={k: v for k, v in params.items() if k not in shape}, seed=None)
