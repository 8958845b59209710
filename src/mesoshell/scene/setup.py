"""Read a scene's files and fill in its defaults, in no engine's terms (loads JAX only to grow a texture)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from os import PathLike
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.geometry import read_usd
from mesoshell.geometry.mesh import FARTHEST, Mesh, bounding_box
from mesoshell.geometry.read import COLLADA, file_of, up_of_collada
from mesoshell.io.image import read_radiance
from mesoshell.io.surface import KIND
from mesoshell.limits import check_memory
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.lamp import Lamp, as_distant, fault_of
from mesoshell.render.light import Distant, Environment, environment
from mesoshell.scene.defaults import axis_of, default_camera, default_lights
from mesoshell.scene.growth import Growth, check_growth, faults_of, growth_of, surface_part, thickness_and_scale
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.scene import Scene
from mesoshell.scene.unpack import unpack
from mesoshell.surface_material.scene import SurfaceDescription, SurfacePart

#: Most irradiance or radiance: sums of it stay finite in float32.
BRIGHTEST = 1e30
#: A note says what engine jax makes of a lamp where half of the size of what is lit is above this share of its distance.
NEAR = 0.1
#: Share of all lamps' light that engine jax may leave out, of the faintest; places at which their light is measured.
DIM, PLACES = 1e-3, 1024

DescriptionT = TypeVar("DescriptionT", "ShellDescription", SurfaceDescription)


@dataclass(frozen=True, eq=False)
class ShellDescription(Growth):
    """A scene's growth with its camera and lights. others: the growths of `Scene.also`; surfaces: those of it that have a
    surface material; notes: of these too; lamps: of engine mitsuba (`with_distant_lamps`)."""

    camera: Camera
    lights: tuple[Distant, ...]
    environment: Environment | None
    base_colour: tuple[float, float, float]
    objects: tuple[Mesh, ...]
    transparent: bool
    holdout: bool
    others: tuple[Growth, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    surfaces: tuple[SurfacePart, ...] = ()

    @property
    def growths(self) -> tuple[Growth, ...]:
        """All of them, the scene's own first."""
        return self, *self.others


def describe_shell(scene: Scene, progress: Callable[[float], None] = lambda share: None) -> ShellDescription:
    """The description of a scene with neural shells. progress: of growing textures. Raises InputError."""
    _check_values(scene)
    scene = unpack(scene)
    count, others, surfaces = 1 + len(scene.also), [], []
    own = growth_of(scene, lambda share: progress(share / count))
    meshes, notes = [own.mesh], [own.notes]
    for k, part in enumerate(scene.also, 1):
        with faults_of(part):
            if part.material.kind == KIND:
                surfaces.append(surface_part(part))
                notes.append(surfaces[-1].mesh.notes)
            else:
                others.append(growth_of(part, lambda share, k=k: progress((k + share) / count)))
                notes.append(others[-1].notes)
        meshes.append((surfaces if part.material.kind == KIND else others)[-1].mesh)
    up = up_axis(scene)
    camera = camera_of(scene, meshes, up)
    lights, sky = lights_of(scene, camera, up)
    return ShellDescription(
        mesh=own.mesh,
        shell=own.shell,
        material=own.material,
        origin=own.origin,
        alpha=own.alpha,
        maps=own.maps,
        patches_per_uv=own.patches_per_uv,
        notes=_of_all(scene, notes),
        camera=camera,
        lights=lights,
        environment=sky,
        base_colour=scene.base_colour,
        objects=tuple(mesh_of(x) for x in scene.objects),
        transparent=scene.transparent,
        holdout=scene.holdout,
        others=tuple(others),
        lamps=lamps_of(scene),
        surfaces=tuple(surfaces),
    )


def check_shell(scene: Scene) -> tuple[str, ...]:
    """Raise InputError as `describe_shell` does, but grow no texture. What the user should know, a line each."""
    _check_values(scene)
    scene = unpack(scene)
    notes = [check_growth(scene)]
    for part in scene.also:
        with faults_of(part):
            notes.append(check_growth(part))
    return _of_all(scene, notes)


def _of_all(scene: Scene, notes: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Notes of the scene's own growth, and of others, with their names."""
    own, *rest = notes
    return *own, *(f"{part.called}: {x}" for part, some in zip(scene.also, rest, strict=True) for x in some)


def describe_surface(scene: Scene) -> SurfaceDescription:
    """The description of a scene with a surface material. Raises InputError."""
    given = {"params": bool(scene.params)} | {
        k: getattr(scene, k) is not None for k in ("seed", "latent", "thickness", "growth")
    }
    for name in (name for name, is_given in given.items() if is_given):
        raise InputError(Argument(name), f"{scene.material.name} is a surface material: it has none (see `scale`)")
    _check_values(scene)
    scene = unpack(scene)
    if scene.holdout:
        raise InputError(
            Argument("holdout"), f"{scene.material.name} is a surface material: only shells hold objects out"
        )
    (mesh, period, _), up = surface_part(scene), up_axis(scene)
    camera = camera_of(scene, [mesh], up)
    lights, sky = lights_of(scene, camera, up)
    objects = tuple(mesh_of(x) for x in scene.objects)
    return SurfaceDescription(
        mesh, period, camera, lights, sky, scene.base_colour, objects, scene.transparent, lamps_of(scene)
    )


def with_distant_lamps(d: DescriptionT, meshes: Sequence[Mesh]) -> tuple[DescriptionT, tuple[str, ...]]:
    """The description with a distant light in the place of each lamp, which is all that engine jax has: with the lamp's mean
    light over some meshes; and a note, if one is so near that it shows. Lamps that give next to no light there are left out."""
    if not d.lamps:
        return d, ()
    places = _places(meshes)
    suns = [as_distant(lamp, places) for lamp in d.lamps]
    strengths = np.array([sun.irradiance.max() for sun in suns])
    order = np.argsort(-strengths)
    bright = np.zeros(len(suns), bool)
    bright[order[np.cumsum(strengths[order]) - strengths[order] < (1 - DIM) * strengths.sum()]] = True
    low, high = box_of([*meshes, *d.objects]).astype(np.float64)
    ways = np.array([np.linalg.norm(lamp.pose[:3, 3] - (low + high) / 2) for lamp in d.lamps])
    near = int((bright & (np.linalg.norm(high - low) / 2 > NEAR * ways)).sum())
    which = "a lamp is" if len(suns) == 1 else f"{near} of {len(suns)} lamps {'is' if near == 1 else 'are'}"
    note = f"{which} near what is lit: engine jax gives all of that the lamp's mean light, engine mitsuba each place its own"
    lights = (*d.lights, *(sun for sun, kept in zip(suns, bright, strict=True) if kept))
    return replace(d, lights=lights, lamps=()), (note,) if near else ()


def _places(meshes: Sequence[Mesh]) -> Float[np.ndarray, "N 3"]:
    """Places spread over meshes, by area."""
    corner = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]).astype(np.float64)
    size = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    random = np.random.default_rng(0)
    face = np.searchsorted(np.cumsum(size) / size.sum(), (np.arange(PLACES) + 0.5) / PLACES)
    weights = random.dirichlet(np.ones(3), PLACES)
    return np.einsum("nk,nki->ni", weights, corner[face])


def lamps_of(scene: Scene) -> tuple[Lamp, ...]:
    """The scene's lamps, of arrays. Raises InputError for what is none."""
    if not isinstance(scene.lamps, Sequence) or not all(isinstance(lamp, Lamp) for lamp in scene.lamps):
        raise InputError(Argument("lamps"), f"must be a list of Lamp, not {scene.lamps!r}")
    for fault in filter(None, (fault_of(lamp, FARTHEST, BRIGHTEST) for lamp in scene.lamps)):
        raise InputError(Argument("lamps"), fault)
    return tuple(
        Lamp(kind, np.array(pose, np.float64), np.array(strength, np.float64), cone)
        for kind, pose, strength, cone in scene.lamps
    )


def _check_values(scene: Scene) -> None:
    """Raise InputError for an irradiance or an albedo out of range, or for `objects` or `grow` that are not lists."""
    check_irradiance("irradiance", np.array(scene.irradiance, np.float64))
    if np.shape(scene.base_colour) != (3,):
        raise InputError(Argument("base_colour"), f"must be three numbers, not {scene.base_colour!r}")
    if isinstance(scene.objects, str | PathLike):
        raise InputError(Argument("objects"), f"must be a list of meshes, not {scene.objects!r}")
    if isinstance(scene.grow, str):
        raise InputError(Argument("grow"), f"must be a list of names, not {scene.grow!r}")
    if not all(0 <= v <= 1 for v in scene.base_colour):
        raise InputError(Argument("base_colour"), "must be from 0 to 1: the share of light that it reflects")


def check_irradiance(name: str, irradiance: np.ndarray) -> None:
    """Raise InputError, of the argument `name`, for light that is negative, or above BRIGHTEST."""
    wrong = irradiance[~((irradiance >= 0) & (irradiance <= BRIGHTEST))]
    if wrong.size:
        raise InputError(Argument(name), f"must be from 0 to {BRIGHTEST:g}, not {wrong[0]:g}")


def up_axis(scene: Scene) -> int:
    """1 for y, 2 for z: as given, or as usual for the mesh's file format."""
    if scene.up is None:
        return 1 if isinstance(scene.mesh, Mesh) else axis_of_file(scene.mesh)
    return {"y": 1, "z": 2}[scene.up]


def axis_of_file(path: str | PathLike[str]) -> int:
    """1 for y, 2 for z: what a USD stage or a COLLADA file says, or as usual for a format. Raises InputError
    for one that is none."""
    path = file_of(path)
    suffix = path.suffix.lower()
    if suffix in read_usd.FORMATS:
        return 2 if read_usd.up_of(path) == "z" else 1
    if suffix in COLLADA:
        return 2 if up_of_collada(path) == "z" else 1
    return 2 if suffix in (".ply", ".stl", ".3mf") else 1


def lights_of(scene: Scene, camera: Camera, up: int) -> tuple[tuple[Distant, ...], Environment | None]:
    """The distant lights and the environment given, or three lights if there are none, nor lamps. Raises InputError."""
    lights = tuple(light_of(light, scene.irradiance) for light in scene.lights)
    sky = environment_of(scene.environment, up)
    if not lights and sky is None and not scene.lamps:
        lights = default_lights(camera, up, scene.irradiance)
    return lights, sky


def check_size(source: str, size: object) -> tuple[int, int]:
    """Width and height of a picture, pixels. Raises InputError, about `source`, unless it has some, and memory holds it."""
    if not isinstance(size, Sequence) or len(size) != 2 or not all(isinstance(n, Integral) for n in size):
        raise InputError(source, f"must be two whole numbers, width and height, not {size!r}")
    width, height = int(size[0]), int(size[1])
    if width < 1 or height < 1:
        raise InputError(source, f"{width} x {height} has no pixels")
    check_memory(source, f"a picture of {width} x {height}", 64 * width * height)
    return width, height


def box_of(meshes: Sequence[Mesh]) -> Float[np.ndarray, "2 3"]:
    """The least and the greatest coordinates of some meshes."""
    corners = np.concatenate([bounding_box(mesh) for mesh in meshes])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def camera_of(scene: Scene, meshes: Sequence[Mesh], up: int) -> Camera:
    """The camera given, or one that frames what is grown: the scene's mesh and those of `also`. Raises InputError."""
    given = scene.camera
    source, size = Argument("size"), scene.size
    if isinstance(given, Camera):
        source, size = Argument("camera"), (given.width, given.height)
        if not np.abs(given.to_world).max() <= FARTHEST:
            raise InputError(source, f"holds a number beyond {FARTHEST:g}")
    width, height = check_size(source, size)
    if isinstance(given, Camera):
        return given
    if given is None:
        each = zip((scene, *scene.also), meshes, strict=True)
        grown = [(part, mesh) for part, mesh in each if part.material.kind != KIND]
        layer = max((thickness_and_scale(part, mesh)[0] for part, mesh in grown), default=0.0)
        return default_camera(box_of(meshes), layer, (width, height), up)
    numbers = [float(x) for x in given]
    if len(numbers) != 7:
        raise InputError(Argument("camera"), f"holds {len(numbers)} numbers: eye, target and field of view are 7")
    eye, target, degrees = tuple(numbers[:3]), tuple(numbers[3:6]), numbers[6]
    if not np.abs(numbers).max() <= FARTHEST:
        raise InputError(Argument("camera"), f"holds a number that is not finite, or beyond {FARTHEST:g}")
    if not 0 < degrees < 180:
        raise InputError(Argument("camera"), f"a field of view of {degrees:g} degrees is not between 0 and 180")
    if eye == target:
        raise InputError(Argument("camera"), "eye and target are the same point")
    return Camera(look_at(eye, target, axis_of(up)), np.radians(degrees), width, height)


def light_of(given: Distant | tuple[float, float, float], irradiance: float) -> Distant:
    """A distant light, of this irradiance if only a direction is given. Raises InputError."""
    toward, strength = (given.direction, given.irradiance) if isinstance(given, Distant) else (given, irradiance)
    direction, strength = np.asarray(toward, np.float64), np.asarray(strength, np.float64)
    if direction.shape != (3,) or strength.shape not in ((), (3,)):
        raise InputError(Argument("lights"), f"{given} is neither a direction x, y, z nor a Distant")
    length = float(np.linalg.norm(direction))
    if not (np.isfinite(length) and length > 0):
        raise InputError(Argument("lights"), f"{tuple(map(float, direction))} is no direction")
    check_irradiance("lights", strength)
    return Distant(direction / length, np.broadcast_to(strength, 3).copy())


def environment_of(given: str | PathLike[str] | Float[np.ndarray, "H W 3"] | None, up: int) -> Environment | None:
    """A latitude-longitude image as an environment. up: axis, 1 or 2. Raises InputError."""
    if given is None:
        return None
    image = given if isinstance(given, np.ndarray) else read_radiance(given)
    check_environment(image, Argument("environment") if isinstance(given, np.ndarray) else given)
    return environment(image, up)


def check_environment(image: np.ndarray, source: str | PathLike[str]) -> None:
    """Raise InputError(source, …) unless an image is one of light."""
    if image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise InputError(source, f"has shape {image.shape}; expected (H, W, 3)")
    if not (image.min() >= 0 and 0 < image.max() <= BRIGHTEST):  # NaN is neither
        raise InputError(source, f"holds negative light, no light, or more than {BRIGHTEST:g}")
