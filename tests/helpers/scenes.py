"""Small scenes that several test files render: the unit slab under a camera, grown with any bundle."""

import numpy as np

from mesoshell.geometry.mesh import Mesh, check_mesh
from mesoshell.io.bundle import Bundle
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.effects import Effects, plan_effects
from mesoshell.render.facts import Facts
from mesoshell.render.light import Distant
from mesoshell.render.quality import Quality
from mesoshell.shell.geometry.extrude import Shell
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render.scene import Scene

#: Every sample decoded, none skipped, nothing filtered: what laws can be tested on exactly.
FULL = Quality(
    pixel_samples=1,
    samples=32,
    spacing="length",
    early_stop=0.0,
    skip=0.0,
    weight_cut=0.0,
    light_samples=0,
    filtering=False,
)


def lights(strength: float = 3.0) -> tuple[Distant, ...]:
    toward = np.array([0.48, -0.36, 0.8])
    return (Distant(toward, np.array([1.0, 0.9, 0.7]) * strength),)


def unit_box() -> Shell:
    """The canonical slab: [0, 1]² at height 0, extruded by 1, texture coordinates equal to positions."""
    base = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Shell(
        base=base,
        offset=np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        faces=faces,
        uv=base[faces][:, :, :2],
        neighbour=np.array([[-1, -1, 1], [0, -1, -1]], np.int32),
        neighbour_edge=np.array([[-1, -1, 0], [2, -1, -1]], np.int32),
        mesh_face=np.arange(2, dtype=np.int32),
        notes=(),
    )


def slab_mesh() -> Mesh:
    box = unit_box()
    return check_mesh(box.base, box.faces, box.uv, "slab")


def slab(bundle: Bundle) -> Scene:
    """The unit slab seen aslant from above, under one distant light."""
    camera = Camera(look_at((0.2, -1.4, 2.2), (0.5, 0.5, 0.4), (0.0, 0.0, 1.0)), 0.7, 16, 16)
    alpha = np.array([0.5], np.float32)
    return Scene(slab_mesh(), unit_box(), load_device_material(bundle), camera, lights(), alpha=alpha)


def effects(scene: Scene, quality: Quality, coarsest: float = 8.0) -> Effects:
    """The plan for a scene on a convex mesh whose footprints reach `coarsest` texels."""
    return plan_effects(
        Facts(
            shells=1,
            objects=len(scene.objects),
            distant=len(scene.lights),
            environment=scene.environment is not None,
            seen=not scene.transparent,
            convex=True,
            coarsest=coarsest,
            varying=tuple(scene.maps),
        ),
        quality,
    )
