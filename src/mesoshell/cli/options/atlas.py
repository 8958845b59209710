"""Options of `mesoshell atlas`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class Capture:
    """Photograph a mesh with Blender from a dome around it: images, masks and a point cloud, to try the other verbs with."""

    #: OBJ, PLY, GLB, glTF, USD, OFF, STL, 3MF or COLLADA file, also in a .zip.
    mesh: tyro.conf.Positional[Path]
    #: Folder to write; must not exist.
    out: Path
    #: Number of photographs.
    views: int = 49
    #: Side of the square photographs in pixels.
    size: int = 128
    #: Light paths a pixel.
    spp: int = 64
    #: Image that the mesh is painted with, by its texture coordinates; cream with brown patches if not given.
    paint: Path | None = None
    #: Light from the camera alone, in otherwise black surroundings.
    flash: bool = False
    #: Points of the cloud, and standard deviation of their distance from the surface, over the box's longest side.
    points: int = 2000
    noise: float = 0.005
    #: Seed of the cloud.
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Train:
    """Learn an object from a folder of photographs; a run that was stopped goes on."""

    #: Folder with transforms.json, with cameras.npz beside image/ and mask/, or with a COLMAP model.
    capture: tyro.conf.Positional[Path]
    #: Folder of checkpoints and log; if it holds some, the training goes on from there.
    run: Path
    #: tiny checks that everything works; small is for two cores; paper is as published, for a GPU.
    preset: Literal["tiny", "small", "paper"] = "small"
    #: Encoding of points for the networks: hash learns faster; frequency is the paper's. Default: frequency for --preset paper,
    #: else hash. An experiment sets its own.
    encoding: Literal["hash", "frequency"] | None = None
    #: A Python file whose `variant` makes a mesoshell.train.neutex.step.NeuTexTrainConfig of a preset; instead of --encoding.
    experiment: Path | None = None
    #: Colour behind the object, in photographs that have neither masks nor alpha.
    background: Literal["black", "white"] | None = None
    #: Thousands of rays to learn from; the preset's if not given.
    kimg: float | None = None


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Write an object's texture as an image that can be painted on."""

    #: Folder of a run, or one of its snapshots.
    object: tyro.conf.Positional[Path]
    #: PNG (sRGB), or EXR (linear).
    out: Path
    #: cubemap: six faces of a cube, seen from outside, 3 across; latlong: twice as wide as high; square: one square.
    layout: Literal["cubemap", "latlong", "square"] = "cubemap"
    #: Pixels of a face's or the square's side; of latlong, its height.
    size: int = 512
    #: What to write. Of an object with reflectance, colour is albedo; its roughness and specular are numbers in an EXR.
    part: Literal["colour", "roughness", "specular"] = "colour"


@dataclass(frozen=True, kw_only=True)
class Render:
    """Render an object from a path of cameras, perhaps with another texture."""

    #: Folder of a run, or one of its snapshots.
    object: tyro.conf.Positional[Path]
    #: Folder for the frames, NNNN.png and NNNN.exr (linear RGBA). Those of a longer path rendered there before are removed.
    out: Path
    #: Once around the object, the photographs' cameras, or those that were held out.
    path: Literal["orbit", "photographs", "held-out"] = "orbit"
    #: Frames of the orbit.
    frames: int = 24
    #: Width and height of an orbit's frames in pixels.
    size: tuple[int, int] = (256, 256)
    #: An edited texture: PNG, JPEG or EXR; its transparent parts leave the object as it is.
    texture: Path | None = None
    #: Replace the object's texture by the edited one, or multiply the two.
    edit: Literal["replace", "multiply"] = "replace"
    #: Layout of the edited texture; by its proportions if not given.
    layout: Literal["cubemap", "latlong", "square"] | None = None
    #: Show a checkerboard instead of the texture.
    checker: bool = False
    #: Direction toward a distant light, x y z in the photographs' axes, for an object with reflectance; may be repeated.
    #: Without any, and without an environment, the camera's flash lights it.
    light: Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction] = ()
    #: Irradiance of each light on a plane facing it.
    irradiance: float = 3.0
    #: Latitude-longitude EXR or HDR that lights it.
    environment: Path | None = None
    #: The axis of the photographs that points up in the environment.
    up: Literal["y", "z"] = "y"
    #: Effort: rays a pixel, directions of an environment, and how much light a ray may leave out.
    quality: Literal["draft", "normal", "reference"] = "normal"
    #: Samples a ray; as many as in training if not given, and at least 256 with --quality reference.
    samples: int | None = None


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Write an object's surface as a mesh with its texture, in the photographs' own frame and units. A GLB also
    holds the roughness of an object with reflectance."""

    #: Folder of a run, or one of its snapshots.
    object: tyro.conf.Positional[Path]
    #: GLB, or OBJ with its MTL and PNG beside it.
    out: Path
    #: Quads along a side of the cube that is wrapped around the object.
    quads: int = 64
    #: Pixels of a cube face's side in the texture.
    size: int = 512


@dataclass(frozen=True)
class Options:
    """Learn objects from photographs, edit their textures, export them as meshes."""

    command: Annotated[Capture | Train | Texture | Render | Mesh, tyro.conf.arg(name="")]
