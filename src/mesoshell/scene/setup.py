"""Read a scene's files and fill in its defaults, in no engine's terms (loads JAX only to grow a texture)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.geometry.mesh import FARTHEST, Mesh, bounding_box
from mesoshell.io.bundle import Bundle
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.io.image import read_exr
from mesoshell.io.material import PARAMS, normalised
from mesoshell.limits import check_memory, check_seed
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.light import Distant, Environment, environment
from mesoshell.scene.defaults import axis_of, default_camera, default_lights
from mesoshell.scene.gltf import unpacked
from mesoshell.scene.kept_meshes import kept_mesh
from mesoshell.scene.materials import read_params
from mesoshell.scene.scene import Scene
from mesoshell.shell.geometry.chart import patches_of
from mesoshell.shell.geometry.extrude import Shell, extrude, patches_per_uv, proportions
from mesoshell.surface_material.scene import SurfaceDescription, default_period

#: Most irradiance or radiance: sums of it stay finite in float32.
BRIGHTEST = 1e30


@dataclass(frozen=True, eq=False)
class ShellDescription:
    """A shell with its material, camera and lights. origin: where the texture begins, (u, v) in patches; alpha: normalised
    parameters; maps: those that vary, (H, W) over the UV square; notes: what the user should know, a line each."""

    mesh: Mesh
    shell: Shell
    material: Bundle
    origin: tuple[int, int]
    camera: Camera
    lights: tuple[Distant, ...]
    environment: Environment | None
    alpha: Float[np.ndarray, "A"]
    maps: dict[str, Float[np.ndarray, "H W"]]
    patches_per_uv: float
    base_colour: tuple[float, float, float]
    objects: tuple[Mesh, ...]
    transparent: bool
    holdout: bool
    notes: tuple[str, ...]


def describe_shell(scene: Scene, progress: Callable[[float], None] = lambda share: None) -> ShellDescription:
    """The description of a scene with a neural shell. progress: of growing a texture. Raises InputError."""
    bundle = scene.material.shell
    _check_colours(scene)
    scene = unpacked(scene)
    check_seed(scene.seed)
    mesh = mesh_of(scene.mesh)
    box = bounding_box(mesh)
    thickness, scale = proportions(mesh, bundle.thickness, scene.thickness, scene.scale)
    shell = extrude(mesh, thickness, scale)
    up = up_axis(scene)
    values, maps = read_params(bundle, scene.params)
    patches = patches_per_uv(mesh, shell)
    shape = {p.name: maps.pop(p.name) for p in bundle.parameters if p.role == "beta" and p.name in maps}
    repeats = bool(mesh.uv.min() < 0 or mesh.uv.max() > 1)
    material, origin, notes = _textured(scene, shell.uv, (values, shape, patches, repeats), progress)
    camera = camera_of(scene, box, thickness, up)
    lights, sky = lights_of(scene, camera, up)
    return ShellDescription(
        mesh=mesh,
        shell=shell,
        material=material,
        origin=origin,
        camera=camera,
        lights=lights,
        environment=sky,
        alpha=normalised(bundle, values),
        maps=maps,
        patches_per_uv=patches,
        base_colour=scene.base_colour,
        objects=tuple(mesh_of(x) for x in scene.objects),
        transparent=scene.transparent,
        holdout=scene.holdout,
        notes=(*mesh.notes, *shell.notes, *notes),
    )


def check_shell(scene: Scene) -> tuple[str, ...]:
    """Raise InputError as `describe_shell` does, but grow no texture. What the user should know, a line each."""
    _check_colours(scene)
    scene = unpacked(scene)
    check_seed(scene.seed)
    mesh, bundle = mesh_of(scene.mesh), scene.material.shell
    normalised(bundle, read_params(bundle, scene.params)[0])
    shell = extrude(mesh, *proportions(mesh, bundle.thickness, scene.thickness, scene.scale))
    return (*mesh.notes, *shell.notes)


def grows(scene: Scene) -> bool:
    """Whether a texture must be grown: the scene needs another than the material holds."""
    bundle = scene.material.shell
    geometry = any(p.role == "beta" and p.name in scene.params for p in bundle.parameters)
    return bundle.generator is not None and (not bundle.baked or scene.seed is not None or geometry)


def _textured(
    scene: Scene,
    uv: np.ndarray,
    wanted: tuple[dict, dict, float, bool],
    progress: Callable[[float], None],
) -> tuple[Bundle, tuple[int, int], list[str]]:
    """The material with a texture for this surface, where the texture begins, and what the user should know. wanted: values of
    parameters, images of geometry, patches a UV unit, and whether images repeat."""
    values, shape, patches, repeats = wanted
    name, bundle = scene.material.name, scene.material.shell
    if grows(scene):
        from mesoshell.shell.generator.texture_synthesis import TextureRequest, field_of, grow

        fields = {key: field_of(image, (patches, patches), repeats) for key, image in shape.items()}
        return *grow(bundle, name, uv.reshape(-1, 3, 2), TextureRequest(scene.seed or 0, values, fields), progress), []
    if scene.seed is not None and bundle.tiles is None:
        raise InputError(Argument("seed"), f"{name} is one texture and has no generator")
    fixed = [p.name for p in bundle.parameters if p.role == "beta" and p.name in values | shape]
    if fixed:
        raise InputError(PARAMS, f"{fixed[0]} is baked into {name}, which has no generator")
    if bundle.wraps:
        return bundle, seed_origin(scene.seed or 0), []
    (u, v), needed = patches_of(uv.reshape(-1, 3, 2))
    texels = bundle.texel_density
    height, width = (n / texels for n in bundle.arrays["features/0"].shape[:2])
    small = needed.shape[1] > width + 2 or needed.shape[0] > height + 2
    note = f"the mesh spans about {needed.shape[1]} × {needed.shape[0]} patches, the texture {width:g} × {height:g}: "
    return bundle, (u, v), [note + "its last texels repeat beyond its edges"] if small else []


def describe_surface(scene: Scene) -> SurfaceDescription:
    """The description of a scene with a surface material. Raises InputError."""
    given = {"params": bool(scene.params), "seed": scene.seed is not None, "thickness": scene.thickness is not None}
    for name in (name for name, is_given in given.items() if is_given):
        raise InputError(Argument(name), f"{scene.material.name} is a surface material: it has none (see `scale`)")
    _check_colours(scene)
    scene = unpacked(scene)
    if scene.holdout:
        raise InputError(
            Argument("holdout"), f"{scene.material.name} is a surface material: only shells hold objects out"
        )
    _check_colours(scene)
    mesh = mesh_of(scene.mesh)
    box, up = bounding_box(mesh), up_axis(scene)
    period = default_period(mesh) if scene.scale is None else scene.scale
    if not (np.isfinite(period) and period > 0):
        raise InputError(Argument("scale"), f"must be above 0, not {period:g}")
    camera = camera_of(scene, box, 0.0, up)
    lights, sky = lights_of(scene, camera, up)
    objects = tuple(mesh_of(x) for x in scene.objects)
    return SurfaceDescription(mesh, period, camera, lights, sky, scene.base_colour, objects, scene.transparent)


def mesh_of(given: str | PathLike[str] | Mesh) -> Mesh:
    """A loaded mesh, or one from its file. Raises InputError."""
    return given if isinstance(given, Mesh) else kept_mesh(given)


def _check_colours(scene: Scene) -> None:
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
    usual = "y" if isinstance(scene.mesh, Mesh) or Path(scene.mesh).suffix.lower() not in (".ply", ".stl") else "z"
    axes = {"y": 1, "z": 2}
    if (scene.up or usual) not in axes:
        raise InputError(Argument("up"), f"must be y or z, not {scene.up}")
    return axes[scene.up or usual]


def lights_of(scene: Scene, camera: Camera, up: int) -> tuple[tuple[Distant, ...], Environment | None]:
    """The lights and the environment given, or three lights if there are none. Raises InputError."""
    lights = tuple(light_of(light, scene.irradiance) for light in scene.lights)
    sky = environment_of(scene.environment, up)
    if not lights and sky is None:
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


def camera_of(scene: Scene, box: np.ndarray, thickness: float, up: int) -> Camera:
    """The camera given, or one that frames a box with a layer about it. Raises InputError."""
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
        return default_camera(box, thickness, (width, height), up)
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
    image = given if isinstance(given, np.ndarray) else read_exr(given)[..., :3]
    check_environment(image, Argument("environment") if isinstance(given, np.ndarray) else given)
    return environment(image, up)


def check_environment(image: np.ndarray, source: str | PathLike[str]) -> None:
    """Raise InputError(source, …) unless an image is one of light."""
    if image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise InputError(source, f"has shape {image.shape}; expected (H, W, 3)")
    if not (image.min() >= 0 and 0 < image.max() <= BRIGHTEST):  # NaN is neither
        raise InputError(source, f"holds negative light, no light, or more than {BRIGHTEST:g}")
