"""Settle a scene: read its files and grow its texture once, for many pictures of it (loads JAX only to grow a texture)."""

from collections.abc import Collection
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mesoshell.io.image import read_radiance
from mesoshell.io.surface import KIND
from mesoshell.kept import constant
from mesoshell.scene.growth import faults_of, grows, growth_image, growth_of, meshes_of, thickness_and_scale
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.materials import Material, read_params
from mesoshell.scene.picture import Progress
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.setup import camera_of, lamps_of, lights_of, up_axis
from mesoshell.scene.unpack import unpack

PartT = TypeVar("PartT", Scene, Grown)


def settle(scene: Scene, progress: Progress = lambda share: None, texture: bool = True) -> Scene:
    """The same scene with what its files hold, and its defaults, in place; its picture is the same, and lights stay where they
    are when its camera moves. progress: of growing the texture. texture: whether to grow it. Raises InputError."""
    scene = unpack(scene)
    up, sky = up_axis(scene), scene.environment
    also = []
    for part in scene.also:
        with faults_of(part):
            also.append(_read(part))
    still = replace(_read(scene), also=tuple(also))
    camera = camera_of(still, meshes_of(still), up)
    still = replace(
        still,
        size=(camera.width, camera.height),
        camera=camera,
        lights=lights_of(scene, camera, up)[0],
        lamps=lamps_of(scene),
        environment=sky if sky is None or isinstance(sky, np.ndarray) else read_radiance(sky),
        objects=tuple(mesh_of(x) for x in scene.objects),
        up="y" if up == 1 else "z",
    )
    return with_textures(still, progress) if texture else still


def with_textures(still: Scene, progress: Progress = lambda share: None, but: Collection[int] = ()) -> Scene:
    """The scene, settled, with its textures grown. but: materials that are left as they are: 0 is the scene's own, 1 and on are
    those of `also`. Raises InputError."""
    also = []
    for k, part in enumerate(still.also, 1):
        with faults_of(part):
            also.append(part if k in but else _with_texture(part, progress))
    still = replace(still, also=tuple(also))
    return still if 0 in but else _with_texture(still, progress)


def _read(part: PartT) -> PartT:
    """With its mesh, the numbers that defaults come to, and images in the place of files."""
    assert part.mesh is not None
    mesh = mesh_of(part.mesh)
    if part.material.kind == KIND:
        return replace(part, mesh=mesh)
    thickness, scale = thickness_and_scale(part, mesh)
    numbers, images = read_params(part.material.shell, part.params)
    growth = None if part.growth is None else growth_image(part.growth)
    return replace(part, mesh=mesh, thickness=thickness, scale=scale, params={**numbers, **images}, growth=growth)


def _with_texture(part: PartT, progress: Progress) -> PartT:
    """With a texture that is grown for it, if one must be, in the place of the parameters of geometry."""
    if not grows(part):
        return part
    given, grown = part.material.shell, growth_of(part, progress).material
    # what both bundles share stays the giver's, who may write to it
    arrays = {key: x.copy() if x is given.arrays.get(key) else x for key, x in grown.arrays.items()}
    material = Material(part.material.name, constant(replace(grown, arrays=arrays)))
    shape = {p.name for p in part.material.shell.parameters if p.role == "beta"}
    params = {k: v for k, v in part.params.items() if k not in shape}
    return replace(part, material=material, params=params, seed=None, latent=None)
