"""What a viewer's user has set, and the scene and the command line that say the same.

Notation
still       the scene as it was given, settled (scene/settle), with the texture of `Look.texture`
sun         azimuth and elevation of a light, degrees; azimuth from where the first camera stands, counter-clockwise seen from
            above
"""

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.light import Distant
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.materials import read_params
from mesoshell.scene.scene import Grown, Scene
from mesoshell.scene.unpack import is_scene_file

#: The name under which `Look.painted` has how high the material grows.
GROWTH = "growth"


@dataclass(frozen=True, eq=False)
class Painting:
    """A painted image, in [0, 1] of its parameter's range. Two are equal if they are the same object."""

    image: Float[np.ndarray, "N N"]


@dataclass(frozen=True, eq=False)
class Sky:
    """A latitude-longitude image of linear radiance, and the name of its file. Two are equal if they are the same object."""

    name: str
    radiance: Float[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class Look:
    """What is set. params: by name; thickness: world; sun and sky: None both for the scene's own lights; quality: a preset's
    name; side: pixels of the longer side; painted: in place of parameters; changes: of the preset's fields."""

    params: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    thickness: float | None = None
    base_colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sun: tuple[float, float] | None = None
    sky: Sky | None = None
    quality: str = "normal"
    side: int = 384
    painted: Mapping[str, Painting] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> Quality:
        """The preset with the changes."""
        return PRESETS[self.quality].with_changes(**self.changes)

    def texture(self, scene: Scene) -> tuple:
        """What of it a grown texture depends on; alike for all looks where none is grown."""
        if not is_generated(scene):
            return ()
        return (
            self.seed,
            *((name, self.painted.get(name, x)) for name, x in sorted(_of_role(scene, self, "beta").items())),
        )


def first_look(scene: Scene) -> Look:
    """The look of a scene as it was given. Parameters that an image varies stay as they are, and geometry without a
    generator. Raises InputError."""
    values, images = {}, {}
    if scene.material.kind != KIND:
        values, images = read_params(scene.material.shell, scene.params)
    free = {
        n: p
        for n, p in scene.material.parameters.items()
        if n not in images and (p.role == "alpha" or is_generated(scene))
    }
    params = {name: values.get(name, p.default) for name, p in free.items()}
    return Look(params, scene.seed or 0, scene.thickness, scene.base_colour)


def is_generated(scene: Scene) -> bool:
    """Whether a generator makes the scene's texture."""
    return scene.material.kind != KIND and scene.material.shell.generator is not None


def with_texture_of(begun: Scene, look: Look) -> Scene:
    """The scene whose texture a look wants, for `settle`."""
    seed = look.seed if is_generated(begun) else begun.seed
    return replace(begun, params={**begun.params, **_values(begun, look, "beta")}, seed=seed)


def scene_of_look(begun: Scene, still: Scene, look: Look, camera: Camera, lit: bool) -> Scene:
    """The scene that a look and a camera show. begun: as it was given; still: with the look's texture, settled; lit: whether
    it was given lights, or default ones stand about each camera."""
    tiled = begun.material.kind != KIND and begun.material.shell.tiles is not None
    lights, lamps, sky = (still.lights if lit else ()), still.lamps, still.environment
    if look.sun is not None or look.sky is not None:
        lamps = ()
        lights = () if look.sun is None else (toward_sun(still, look.sun),)
        sky = None if look.sky is None else look.sky.radiance
    return replace(
        still,
        camera=camera,
        params={**still.params, **_values(begun, look, "alpha")},
        seed=look.seed if tiled else still.seed,
        thickness=look.thickness,
        growth=look.painted[GROWTH].image if GROWTH in look.painted else still.growth,
        base_colour=look.base_colour,
        lights=lights,
        lamps=lamps,
        environment=sky,
    )


def describe_look(begun: Scene, look: Look, camera: Camera, lit: bool) -> Scene:
    """What `look_scene` shows, with parameters in place of a grown texture."""
    other = look.texture(begun) != first_look(begun).texture(begun)
    return scene_of_look(begun, with_texture_of(begun, look) if other else begun, look, camera, lit)


def _of_role(scene: Scene, look: Look, role: str) -> dict[str, float]:
    return {name: x for name, x in look.params.items() if scene.material.parameters[name].role == role}


def _values(scene: Scene, look: Look, role: str) -> dict[str, Any]:
    """Numbers and painted images."""
    images = {name: painting.image for name, painting in look.painted.items()}
    return {name: images.get(name, x) for name, x in _of_role(scene, look, role).items()}


def toward_sun(still: Scene, sun: tuple[float, float]) -> tuple[float, float, float]:
    """Direction toward a sun."""
    assert isinstance(still.camera, Camera)
    up = np.eye(3)[1 if still.up == "y" else 2]
    back = still.camera.to_world[:3, 2] - (still.camera.to_world[:3, 2] @ up) * up
    back = back / np.linalg.norm(back) if np.linalg.norm(back) > 1e-9 else np.roll(up, 1)
    azimuth, elevation = (math.radians(x) for x in sun)
    level = math.cos(azimuth) * back + math.sin(azimuth) * np.cross(up, back)
    x, y, z = math.cos(elevation) * level + math.sin(elevation) * up
    return float(x), float(y), float(z)


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
    words = ["mesoshell", "render", str(given.mesh), "--material", given.material.name]
    words += _option("camera", *eye, *(eye - back), math.degrees(scene.camera.fov))
    words += _option("size", scene.camera.width, scene.camera.height)
    images = {name: value for name, value in given.params.items() if name not in look.params}
    painted = {name: f"{name}.exr" for name in look.painted}
    growth = painted.pop(GROWTH, given.growth)
    for name, value in {**images, **look.params, **painted}.items():
        words += ["--param", f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value}"]
    if look.texture(given) or look.seed:
        words += ["--seed", str(look.seed)]
    for name, value in (("thickness", look.thickness), ("scale", scene.scale)):
        words += [] if value is None else _option(name, value)
    words += [] if growth is None else ["--growth", str(growth)]
    words += _option("base", *look.base_colour)
    own = look.sun is None and look.sky is None
    for light in given.lights if own else scene.lights:
        assert not isinstance(light, Distant)
        words += _option("light", *light)
    if not given.suns or (is_scene_file(given.mesh) and not own and not scene.lights):
        words += ["--no-suns"]
    words += _option("irradiance", given.irradiance)
    sky = look.sky.name if look.sky is not None else given.environment if own else None
    if sky is not None:
        words += ["--environment", str(sky)]
    for name in given.grow:
        words += ["--grow", name]
    for mesh in given.objects:
        words += ["--object", str(mesh)]
    for one in given.also:
        words += _further(one)
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


def _further(one: Grown) -> list[str]:
    """A further material, with what is set of it."""
    name, words = one.material.name, []
    for node in one.grow:
        words += ["--grow", f"{node}={name}"]
    if one.mesh is not None:
        words += ["--object", f"{one.mesh}={name}"]
    said = {"thickness": one.thickness, "scale": one.scale, "seed": one.seed, "growth": one.growth, **one.params}
    for key, value in said.items():
        words += [] if value is None else ["--param", f"{name}:{key}={value}"]
    return words


def _option(name: str, *numbers: float | int) -> list[str]:
    return [f"--{name}", *(f"{x:.6g}" for x in numbers)]
