"""A scene as its user describes it, in no engine's terms (no JAX)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Literal

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.lamp import Lamp
from mesoshell.render.light import Distant
from mesoshell.scene.defaults import IRRADIANCE, SIZE
from mesoshell.scene.materials import Image, Material, Value
from mesoshell.shell.geometry.extrude import EARTH

#: x, y, z in the mesh's axes.
Direction = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Grown:
    """A further mesh with a material of its own: `Scene.also`.

    mesh: as of a Scene; or None, and `grow` names nodes of the scene's own file.
    material: of `load_material`; a surface material beside shells requires `engine` mitsuba.
    thickness, scale, params, seed, latent, growth: as of a Scene; a surface material has only `scale`.
    name: by which faults and a film's keys call it, NAME:PARAMETER. Default: its material's.
    """

    mesh: str | PathLike[str] | Mesh | None
    material: Material
    grow: Sequence[str] = ()
    thickness: float | None = None
    scale: float | None = None
    params: Mapping[str, Value] = field(default_factory=dict)
    seed: int | None = None
    growth: Image | None = None
    name: str | None = None
    latent: tuple[int, float] | None = None

    @property
    def called(self) -> str:
        """Its name, or its material's."""
        return self.material.name if self.name is None else self.name

    def __post_init__(self) -> None:
        _check_material(self.material)
        if self.name is not None and not (isinstance(self.name, str) and self.name):
            raise InputError(Argument("also"), f"name must be a text that is not empty, not {self.name!r}")
        if isinstance(self.grow, str):
            raise InputError(Argument("grow"), f"must be a list of names, not {self.grow!r}")
        if (self.mesh is None) is (not self.grow):
            raise InputError(Argument("also"), f"{self.material.name} takes either a mesh or `grow`")
        if self.material.kind == KIND:
            given = {"params": bool(self.params)}
            given |= {k: getattr(self, k) is not None for k in ("seed", "latent", "thickness", "growth")}
            for name in (name for name, is_given in given.items() if is_given):
                fault = f"{self.material.name} is a surface material: it has none (see scale)"
                raise InputError(Argument(f"{self.called}:{name}"), fault)


@dataclass(frozen=True, eq=False)
class Scene:
    """A mesh grown with a material, its camera and its lights.

    mesh: an OBJ, PLY, GLB, glTF, USD, OFF, STL, 3MF or COLLADA file, also in a .zip, unwrapped if it has no texture
        coordinates; or a loaded mesh.
    grow: names of a glTF file's nodes or materials, or paths of a USD stage's prims or subsets, that the material grows on; the
        file's other meshes stand beside them, as `objects` do, in their materials' diffuse colours or images. Default: on all
        that no material of `also` grows on.
    material: of `load_material`.
    thickness: height of the shell in the mesh's unit. Default: the material's own thickness times `scale`, or 1/25 of the
        bounding box's diagonal. A surface material has none.
    scale: world length of one texture patch, or of a surface material's period, in the mesh's unit. Default:
        `thickness` over the material's own (1 for bundled shells); for surface materials 2/25 of the diagonal.
    params: values of the material's parameters, by name: a number in the parameter's unit, or an image that varies it over the
        UV square, a file or (H, W) in [0, 1], whose black to white spans the parameter's range.
    seed: which of a generator's textures grows on the mesh; or in which order corner tiles lie; a material that is one patch
        has no other. Default: 0.
    latent: another seed and a share from 0 to 1: how far a generator's latent z is on its way to that of the other seed. The
        phases, so where blades may stand, stay those of `seed`. For generators that were trained with a latent.
    growth: how high the material grows over the UV square: an image, as a file or (H, W), of shares of `thickness` from 0 to 1,
        a file's codes over the largest; nothing grows where it is black. The mesh is refined to show it, to 131072 triangles
        at most.
    size: width and height of the picture in pixels.
    camera: eye x y z, target x y z and vertical field of view in degrees; or a Camera, which has a size of its own. Default:
        the first of such a file, else it frames the mesh from the upper front.
    lights: distant ones: a direction toward each, x y z in the mesh's axes, or a Distant. Default: the suns of
        such a file, where no `lamps` are given; without any, key, fill and bounce, unless there is an environment or a lamp.
    lamps: lights that stand somewhere. Engine jax replaces each by a distant light, with its mean light on what is grown, from
        the same side. Default: such a file's, where no `lights` are given.
    suns: whether such a file's suns and lamps, and a USD stage's dome light, light the scene where neither `lights` nor `lamps`
        are given.
    irradiance: of each light that is a direction, on a plane facing it; 3.14 makes a white wall white.
    environment: a latitude-longitude EXR or HDR file, or its linear radiance (H, W, 3), that lights the scene and is seen
        behind it; its middle lies toward +x, as in Blender. Default: the dome light of a USD stage, where neither `lights` nor
        `lamps` are given.
    base_colour: diffuse albedo of the surface under a shell, and of `objects` without a colour, linear Rec. 709, each from 0
        to 1.
    objects: further meshes in the same frame that cast and receive shadows.
    also: further meshes in the same frame, each with a material of its own, where the scene's own is a shell.
    up: the axis that points up, "y" or "z". Default: what a USD stage or a COLLADA file says (z, or else y), z for
        PLY, STL and 3MF files, y for others.
    transparent: whether the background is transparent even where there is an environment.
    holdout: whether the picture is transparent where it would show `objects`, so that it lies over a picture of them; they
        still cast and receive shadows. Shells by engine jax alone.

    Files are read, and values checked, when the scene is rendered or explained. Raises InputError unless `material` is one.
    """

    mesh: str | PathLike[str] | Mesh
    material: Material
    thickness: float | None = None
    scale: float | None = None
    params: Mapping[str, Value] = field(default_factory=dict)
    seed: int | None = None
    size: tuple[int, int] = SIZE
    camera: Camera | Sequence[float] | None = None
    lights: Sequence[Distant | Direction] = ()
    irradiance: float = IRRADIANCE
    environment: str | PathLike[str] | Float[np.ndarray, "_ _ 3"] | None = None
    base_colour: tuple[float, float, float] = EARTH
    objects: Sequence[str | PathLike[str] | Mesh] = ()
    up: Literal["y", "z"] | None = None
    grow: Sequence[str] = ()
    transparent: bool = False
    holdout: bool = False
    also: Sequence[Grown] = ()
    suns: bool = True
    lamps: Sequence[Lamp] = ()
    growth: Image | None = None
    latent: tuple[int, float] | None = None

    def __post_init__(self) -> None:
        _check_material(self.material)
        if not isinstance(self.also, Sequence) or not all(isinstance(x, Grown) for x in self.also):
            raise InputError(Argument("also"), f"must be a list of Grown, not {self.also!r}")
        if self.also and self.material.kind == KIND:
            raise InputError(
                Argument("also"),
                f"{self.material.name} is a surface material: it stands beside a shell, as a further material, not before it",
            )


def _check_material(material: object) -> None:
    if not isinstance(material, Material):
        raise InputError(Argument("material"), f"must be a Material, as load_material gives, not {material!r}")
