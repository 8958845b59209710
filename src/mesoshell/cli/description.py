"""What `mesoshell render MESH` is asked to show, in no engine's own terms (no JAX, but where a texture must be grown).

Alphabet
diagonal    of the mesh's bounding box, world
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mesoshell.cli.material import given
from mesoshell.cli.render import Options
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import FARTHEST, Mesh, bounding_box, load_mesh
from mesoshell.io.bundle import Bundle
from mesoshell.io.image import read_exr
from mesoshell.io.material import normalised
from mesoshell.limits import check_memory, check_seed
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.light import Distant, Environment, environment
from mesoshell.shell.chart import patches_of
from mesoshell.shell.extrude import Shell, extrude, patches_per_uv, proportions
from mesoshell.silhouette.scene import SurfaceDescription

#: Fill light of the default lighting, and the light from below, as shares of the key light.
FILL, BOUNCE = 0.3, 0.12
#: Irradiance or radiance, at most: sums of it are numbers in single precision.
BRIGHTEST = 1e30


@dataclass(frozen=True, eq=False)
class Description:
    """A shell, the texture in it, which begins at `origin` (u, v; patches), and what it is seen by. alpha: normalised
    parameters; maps: those that vary, (H, W) over the UV square. notes: what the user should know, a line each."""

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
    notes: tuple[str, ...]


def describe(options: Options, bundle: Bundle, progress: Callable[[float], None] = lambda share: None) -> Description:
    """What the options ask for. progress: of growing a texture. Raises InputError."""
    check_colours(options)
    check_seed(options.seed)
    mesh = load_mesh(options.mesh)
    box = bounding_box(mesh)
    thickness, scale = proportions(mesh, bundle.thickness, options.thickness, options.scale)
    shell = extrude(mesh, thickness, scale)
    up = up_axis(options)
    values, maps = given(bundle, options.param)
    patches = patches_per_uv(mesh, shell)
    shape = {p.name: maps.pop(p.name) for p in bundle.parameters if p.role == "beta" and p.name in maps}
    repeats = bool(mesh.uv.min() < 0 or mesh.uv.max() > 1)
    material, origin, said = _textured(options, bundle, shell.uv, (values, shape, patches, repeats), progress)
    camera = camera_of(options, box, thickness, up)
    lights, sky = lights_of(options, camera, up)
    return Description(
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
        base_colour=options.base,
        objects=tuple(load_mesh(p) for p in options.object),
        transparent=options.transparent,
        notes=(*mesh.notes, *shell.notes, *said),
    )


def _textured(
    options: Options,
    bundle: Bundle,
    uv: np.ndarray,
    asked: tuple[dict, dict, float, bool],
    progress: Callable[[float], None],
) -> tuple[Bundle, tuple[int, int], list[str]]:
    """The material with a texture for this surface, where the texture begins, and what the user should know. asked: values of
    parameters, images of geometry, patches a UV unit, and whether images repeat."""
    values, shape, patches, repeats = asked
    fixed = [p.name for p in bundle.parameters if p.role == "beta" and p.name in values | shape]
    if bundle.generator is not None and (not bundle.baked or options.seed is not None or fixed):
        from mesoshell.shell.grow import Wanted, field_of, grow

        fields = {name: field_of(image, (patches, patches), repeats) for name, image in shape.items()}
        wanted = Wanted(options.seed or 0, values, fields)
        return *grow(bundle, options.material, uv.reshape(-1, 3, 2), wanted, progress), []
    if options.seed is not None:
        raise InputError("--seed", f"{options.material} is one texture and has no generator")
    if fixed:
        raise InputError("--param", f"{fixed[0]} is baked into {options.material}, which has no generator")
    if bundle.wraps:
        return bundle, (0, 0), []
    (u, v), needed = patches_of(uv.reshape(-1, 3, 2))
    texels = bundle.texel_density
    height, width = (n / texels for n in bundle.arrays["features/0"].shape[:2])
    small = needed.shape[1] > width + 2 or needed.shape[0] > height + 2
    said = f"the mesh spans about {needed.shape[1]} × {needed.shape[0]} patches, the texture {width:g} × {height:g}: "
    return bundle, (u, v), [said + "its last texels repeat beyond its edges"] if small else []


def describe_surface(options: Options) -> SurfaceDescription:
    """What the options ask for, of a surface material. Raises InputError."""
    for name in ("param", "seed", "thickness"):
        if getattr(options, name) not in ((), None):
            raise InputError(f"--{name}", f"{options.material} is a surface material: it has none (see --scale)")
    check_colours(options)
    mesh = load_mesh(options.mesh)
    box, up = bounding_box(mesh), up_axis(options)
    period = float(np.linalg.norm(box[1] - box[0])) * 2 / 25 if options.scale is None else options.scale
    if not (np.isfinite(period) and period > 0):
        raise InputError("--scale", f"must be above 0, not {period:g}")
    camera = camera_of(options, box, 0.0, up)
    lights, sky = lights_of(options, camera, up)
    objects = tuple(load_mesh(p) for p in options.object)
    return SurfaceDescription(mesh, period, camera, lights, sky, options.base, objects, options.transparent)


def check_colours(options: Options) -> None:
    """Raises InputError for a light or a surface that is darker than black, or brighter than can be."""
    if not 0 <= options.irradiance <= BRIGHTEST:
        raise InputError("--irradiance", f"must be from 0 to {BRIGHTEST:g}, not {options.irradiance:g}")
    if not all(0 <= v <= 1 for v in options.base):
        raise InputError("--base", "must be from 0 to 1: what is reflected of the light that falls on it")


def up_axis(options: Options) -> int:
    """1 for y, 2 for z: as asked for, or as is usual for the mesh's kind of file."""
    return {"y": 1, "z": 2}[options.up or ("z" if options.mesh.suffix.lower() in (".ply", ".stl") else "y")]


def lights_of(options: Options, camera: Camera, up: int) -> tuple[tuple[Distant, ...], Environment | None]:
    """The lights and the environment asked for, or three lights if there are none. Raises InputError."""
    lights = tuple(_light(v, options.irradiance) for v in options.light)
    sky = _environment(options, up)
    if not lights and sky is None:
        lights = _default_lights(camera, up, options.irradiance)
    return lights, sky


def camera_of(options: Options, box: np.ndarray, thickness: float, up: int) -> Camera:
    """The camera asked for, or one that frames a box with a layer about it. Raises InputError."""
    width, height = options.size
    if width < 1 or height < 1:
        raise InputError("--size", f"{width} x {height} has no pixels")
    check_memory("--size", f"a picture of {width} x {height}", 64 * width * height)
    axis = (0.0, 1.0, 0.0) if up == 1 else (0.0, 0.0, 1.0)
    if options.camera is not None:
        eye, target, degrees = options.camera[:3], options.camera[3:6], options.camera[6]
        if not np.abs(options.camera).max() <= FARTHEST:
            raise InputError("--camera", f"holds a number that is not finite, or beyond {FARTHEST:g}")
        if not 0 < degrees < 180:
            raise InputError("--camera", f"a field of view of {degrees:g} degrees is not between 0 and 180")
        if eye == target:
            raise InputError("--camera", "eye and target are the same point")
        return Camera(look_at(eye, target, axis), np.radians(degrees), width, height)
    fov = np.radians(35.0)
    centre, radius = box.mean(axis=0), np.linalg.norm(box[1] - box[0]) / 2 + thickness
    narrow = 2 * np.arctan(np.tan(fov / 2) * min(1.0, width / height))
    front = np.array([0.55, 0.4, 0.75]) if up == 1 else np.array([0.55, -0.75, 0.4])
    eye = centre + front / np.linalg.norm(front) * radius / np.sin(narrow / 2) * 0.92
    return Camera(look_at(tuple(eye), tuple(centre), axis), float(fov), width, height)


def _light(direction: tuple[float, float, float], irradiance: float) -> Distant:
    length = float(np.linalg.norm(direction))
    if not (np.isfinite(length) and length > 0):
        raise InputError("--light", f"{direction} is no direction")
    return Distant(np.array(direction) / length, np.full(3, irradiance))


def _default_lights(camera: Camera, up: int, irradiance: float) -> tuple[Distant, ...]:
    """A key light over the camera's left shoulder, a weak fill from its right, and a weaker bounce from below."""
    right, back, above = camera.to_world[:3, 0], camera.to_world[:3, 2], np.eye(3)[up]
    lights = (
        (1.1 * above - 0.7 * right + 0.5 * back, (1.0, 0.96, 0.9), 1.0),
        (0.4 * above + right + 0.6 * back, (0.8, 0.9, 1.0), FILL),
        (0.4 * back - above, (0.9, 0.95, 0.85), BOUNCE),
    )
    return tuple(Distant(v / np.linalg.norm(v), np.array(c) * share * irradiance) for v, c, share in lights)


def _environment(options: Options, up: int) -> Environment | None:
    if options.environment is None:
        return None
    image = read_exr(options.environment)[..., :3]
    if not (image.min() >= 0 and 0 < image.max() <= BRIGHTEST):  # NaN is neither
        raise InputError(options.environment, f"holds negative or no light, or more than {BRIGHTEST:g}")
    return environment(image, up)
