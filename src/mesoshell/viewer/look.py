"""What a viewer's user has set, and the scene and the command line that say the same.

Notation
still       the scene as it was given, settled (scene/settle), with the texture of `Look.texture`
part        the scene itself, for its own material, or one of its `also`
sun         as in viewer/sun
"""

import math
import re
import shlex
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh, bounding_box
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.growth import latent_of, surface_part
from mesoshell.scene.materials import read_params
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.unpack import is_scene_file
from mesoshell.viewer.sun import toward_sun

PartT = TypeVar("PartT", Scene, Grown)
#: The name under which `PartLook.painted` has how high the material grows.
GROWTH = "growth"


@dataclass(frozen=True, eq=False)
class Painting:
    """A painted image: in [0, 1] of its parameter's range, or linear premultiplied RGBA. Two are equal if they are the same
    object."""

    image: Float[np.ndarray, "H W *c"]


@dataclass(frozen=True, eq=False)
class Sky:
    """A latitude-longitude image of linear radiance, and the name of its file. Two are equal if they are the same object."""

    name: str
    radiance: Float[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class PartLook:
    """What is set of one material. params: by name; thickness and scale: world; painted: in place of parameters; latent: of a
    Scene."""

    params: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    thickness: float | None = None
    painted: Mapping[str, Painting] = field(default_factory=dict)
    latent: tuple[int, float] | None = None
    scale: float | None = None

    def texture(self, part: Scene | Grown) -> tuple:
        """What of it a grown texture depends on; alike for all looks where none is grown."""
        if not is_generated(part):
            return ()
        shape = sorted(_of_role(part, self, "beta").items())
        return self.seed, self.latent, self.scale, *((name, self.painted.get(name, x)) for name, x in shape)


@dataclass(frozen=True)
class Look(PartLook):
    """What is set, of the scene's own material and of all. also: of further materials; sun and sky: None both for the scene's
    own lights; quality: a preset's name; side: pixels of the longer side; changes: of the preset's fields."""

    also: tuple[PartLook, ...] = ()
    base_colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sun: tuple[float, float] | None = None
    sky: Sky | None = None
    quality: str = "normal"
    side: int = 384
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> Quality:
        """The preset with the changes."""
        return PRESETS[self.quality].with_changes(**self.changes)

    @property
    def parts(self) -> tuple[PartLook, ...]:
        """Of all materials, the scene's own first."""
        return self, *self.also

    def textures(self, scene: Scene) -> tuple[tuple, ...]:
        """`texture` of each material."""
        return tuple(own.texture(part) for own, part in zip(self.parts, parts_of(scene), strict=True))


def parts_of(scene: Scene) -> tuple[Scene | Grown, ...]:
    """The scene, for its own material, and its further ones."""
    return scene, *scene.also


def first_look(scene: Scene) -> Look:
    """The look of a scene as it was given. Parameters that an image varies stay as they are, and geometry without a
    generator. Raises InputError."""
    own, *others = (
        PartLook(_free(part), part.seed or 0, part.thickness, latent=latent_of(part), scale=part.scale)
        if part.material.kind != KIND
        else PartLook(scale=surface_part(part).period)
        for part in parts_of(scene)
    )
    return Look(**vars(own), also=tuple(others), base_colour=scene.base_colour)


def _free(part: Scene | Grown) -> dict[str, float]:
    """Parameters that can be set, with their values."""
    values, images = read_params(part.material.shell, part.params)
    return {
        name: values.get(name, p.default)
        for name, p in part.material.parameters.items()
        if name not in images and (p.role == "alpha" or is_generated(part))
    }


def is_generated(part: Scene | Grown) -> bool:
    """Whether a generator makes the texture."""
    return part.material.kind != KIND and part.material.shell.generator is not None


def with_textures_of(begun: Scene, still: Scene, look: Look, now: Sequence[tuple | None]) -> Scene:
    """The scene whose textures a look wants, for `settle`. still: has textures; now: what each of these depends on."""
    wanted = look.textures(begun)
    also = tuple(
        there if known == want else _to_grow(part, own)
        for part, there, own, known, want in zip(begun.also, still.also, look.also, now[1:], wanted[1:], strict=True)
    )
    scene = still if now[0] == wanted[0] else _to_grow(begun, look)
    return replace(scene, also=also)


def _to_grow(part: PartT, look: PartLook) -> PartT:
    seed = look.seed if is_generated(part) else part.seed
    params = {**part.params, **_values(part, look, "beta")}
    return replace(part, params=params, seed=seed, latent=look.latent, scale=look.scale)


def scene_of_look(begun: Scene, still: Scene, look: Look, camera: Camera, lit: bool) -> Scene:
    """The scene that a look and a camera show. begun: as it was given; still: with the look's textures, settled; lit: whether
    it was given lights, or default ones stand about each camera."""
    still = _worn(begun, still, look)
    also = tuple(_worn(*three) for three in zip(begun.also, still.also, look.also, strict=True))
    lights, lamps, sky = (still.lights if lit else ()), still.lamps, still.environment
    if look.sun is not None or look.sky is not None:
        lamps = ()
        assert isinstance(still.camera, Camera)
        up = np.eye(3)[1 if still.up == "y" else 2]
        lights = () if look.sun is None else (toward_sun(still.camera.to_world, up, look.sun),)
        sky = None if look.sky is None else look.sky.radiance
    return replace(
        still,
        camera=camera,
        also=also,
        base_colour=look.base_colour,
        lights=lights,
        lamps=lamps,
        environment=sky,
    )


def _worn(begun: PartT, still: PartT, look: PartLook) -> PartT:
    """What a look shows of a material beside its texture."""
    tiled = begun.material.kind != KIND and begun.material.shell.tiles is not None
    return replace(
        still,
        params={**still.params, **_values(begun, look, "alpha")},
        seed=look.seed if tiled else still.seed,
        thickness=look.thickness,
        scale=still.scale if is_generated(begun) else look.scale,  # what is grown is so wide
        growth=look.painted[GROWTH].image if GROWTH in look.painted else still.growth,
    )


def describe_look(begun: Scene, look: Look, camera: Camera, lit: bool) -> Scene:
    """What `scene_of_look` shows, with parameters in place of grown textures."""
    wanted = with_textures_of(begun, begun, look, first_look(begun).textures(begun))
    return scene_of_look(begun, wanted, look, camera, lit)


def _of_role(part: Scene | Grown, look: PartLook, role: str) -> dict[str, float]:
    return {name: x for name, x in look.params.items() if part.material.parameters[name].role == role}


def _values(part: Scene | Grown, look: PartLook, role: str) -> dict[str, Any]:
    """Numbers and painted images."""
    images = {name: painting.image for name, painting in look.painted.items()}
    return {name: images.get(name, x) for name, x in _of_role(part, look, role).items()}


def with_size(camera: Camera, side: int) -> Camera:
    """The same view with so many pixels along its longer side."""
    share = side / max(camera.width, camera.height)
    width, height = (max(1, round(n * share)) for n in (camera.width, camera.height))
    return Camera(camera.to_world, camera.fov, width, height)


def command(given: Scene, scene: Scene, look: Look, engine: str, samples: int) -> str:
    """The command line that makes a picture of so many samples a pixel. given: the scene as the viewer got it, of files
    and numbers; scene: what is shown. What is painted is in files NAME.exr, and a sky in one of its name."""
    assert isinstance(scene.camera, Camera)
    eye, back = scene.camera.to_world[:3, 3], scene.camera.to_world[:3, 2]
    far = 1.0  # a target next to an eye that is far from the origin would turn the view
    if isinstance(scene.mesh, Mesh):
        far = float(np.linalg.norm(bounding_box(scene.mesh).astype(np.float64).mean(axis=0) - eye))
    words = ["mesoshell", "render", str(given.mesh), "--material", given.material.name]
    words += _option("camera", *eye, *(eye - max(far, 1e-9) * back), math.degrees(scene.camera.fov))
    words += _option("size", scene.camera.width, scene.camera.height)
    params, fields = _said(given, scene, look)
    latent = fields.pop("latent", None)
    for name, value in params.items():
        words += ["--param", f"{name}={value}"]
    for name, value in fields.items():
        words += [f"--{name}", value]
    words += [] if latent is None else ["--latent", *latent.split(",")]
    words += _option("base", *look.base_colour)
    as_given = look.sun is None and look.sky is None
    for light in given.lights if as_given else scene.lights:
        assert not isinstance(light, Distant)
        words += _option("light", *light)
    if not given.suns or (is_scene_file(given.mesh) and not as_given and not scene.lights):
        words += ["--no-suns"]
    words += _option("irradiance", given.irradiance)
    sky = look.sky.name if look.sky is not None else given.environment if as_given else None
    if sky is not None:
        words += ["--environment", str(sky)]
    for name in given.grow:
        words += ["--grow", name]
    for mesh in given.objects:
        words += ["--object", str(mesh)]
    has_growth = [x.growth is not None or GROWTH in own.painted for x, own in zip(given.also, look.also, strict=True)]
    with_growth = {x.called for x, has in zip(given.also, has_growth, strict=True) if has}
    for one, shown, own in zip(given.also, scene.also, look.also, strict=True):
        words += _further(one, shown, own, one.material.name in with_growth)
    words += [
        "--up",
        scene.up or "y",
        *(["--transparent"] if given.transparent else []),
        *(["--holdout"] if given.holdout else []),
    ]
    words += ["--engine", engine, "--quality", look.quality, "--max-samples", str(samples)]
    for name, value in {"density": "network", **look.changes}.items():
        words += ["--set", f"{name}={str(value).lower()}"]
    return shlex.join(words)


def _further(given: Grown, shown: Grown, look: PartLook, others: bool) -> list[str]:
    """A further material, with what is set of it. others: whether an image of growth is given to all that have the material."""
    name, words = given.material.name, []
    for node in given.grow:
        words += ["--grow", f"{node}={name}"]
    if given.mesh is not None:
        words += ["--object", f"{given.mesh}={name}"]
    params, fields = _said(given, shown, look)
    for key, value in {**params, **({GROWTH: "none"} if others else {}), **fields}.items():
        words += ["--param", f"{given.called}:{key}={value}"]
    return words


def _said(given: PartT, shown: PartT, look: PartLook) -> tuple[dict[str, str], dict[str, str]]:
    """Parameters and fields that are set of a material, as a command line has them."""
    images = {name: value for name, value in given.params.items() if name not in look.params}
    painted = {name: image_of(given, name) for name in look.painted}
    growth = painted.pop(GROWTH, given.growth)
    is_tiled = getattr(given.material.bundle, "tiles", None) is not None
    seed = look.seed if look.texture(given) or look.seed or (is_tiled and isinstance(given, Grown)) else None
    latent = None if look.latent is None else "{},{}".format(*look.latent)
    fields = {"seed": seed, "latent": latent, "thickness": look.thickness, "scale": shown.scale, GROWTH: growth}
    return _spelled({**images, **look.params, **painted}), _spelled(fields)


def _spelled(values: Mapping[str, Any]) -> dict[str, str]:
    return {name: str(x) for name, x in values.items() if x is not None}


def image_of(part: Scene | Grown, name: str) -> str:
    """The name of the file that holds what is painted in place of a parameter."""
    if isinstance(part, Scene):
        return f"{name}.exr"
    plain = re.sub(r"[^\w.-]+", "_", part.called).strip("_.")  # browsers change others
    other = "" if plain == part.called else f"-{zlib.crc32(part.called.encode()):08x}"
    return f"{plain}{other}_{name}.exr"


def _option(name: str, *numbers: float | int) -> list[str]:
    return [f"--{name}", *(f"{x:.12g}" for x in numbers)]
