"""Options that describe a scene, for the verbs that render one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mesoshell.render.quality import PRESETS, SETTINGS, range_of
from mesoshell.scene.defaults import IRRADIANCE
from mesoshell.shell.geometry.extrude import EARTH


def _described(name: str) -> str:
    """A field of a quality: meaning, values, those of the presets, and what cheaper ones bias."""
    setting, presets = SETTINGS[name], [getattr(preset, name) for preset in PRESETS.values()]
    values = ", ".join(str(x) for x in presets) if len(set(presets)) > 1 else str(presets[0])
    only = f" ({setting.engine} only)" if setting.engine else ""
    return f"- {name}{only}: {setting.meaning}; {range_of(name)} [{values}]. Biases {setting.bias or 'nothing'}."


SETTINGS_HELP = (
    "NAME=VALUE of a setting, in place of the --quality's; may be repeated. Each with its values, those of draft, normal and "
    "reference in brackets, and what cheaper values bias:\n\n" + "\n".join(map(_described, SETTINGS))
)


@dataclass(frozen=True)
class SceneOptions:
    """A mesh grown with a neural material, its camera, its lights, and the engine that renders it."""

    #: OBJ, PLY, GLB, glTF, USD, OFF, STL, 3MF or COLLADA file, also in a .zip; without texture coordinates it is unwrapped. For
    #: `render`, `tradeoff` and `view` with --engine mitsuba also an XML scene of Mitsuba's with `mesoshell` BSDFs.
    mesh: tyro.conf.Positional[Path]
    #: Name of a glTF file's node or material, or path of a USD stage's prim or subset, that the material grows on; may be
    #: repeated. The file's other meshes become objects, in their materials' colours or images. NODE=MATERIAL grows another
    #: material on it. Default: every mesh that no NODE=MATERIAL names.
    grow: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    #: A bundled material's name, or a .npz file, or the folder of a large texture. Default: grass; but where nodes of a glTF
    #: file or prims of a USD stage name materials by `mesoshell:material`, each has its own, and the others none.
    material: str | None = None
    #: NAME=VALUE, or NAME=IMAGE to vary it over the UV square (grey; black to white spans its range); may be repeated. A
    #: generator also varies geometry: an image of a carpet's lean angle combs it. MATERIAL:NAME=VALUE is for a further
    #: material, also its thickness, scale, seed, latent (SEED,SHARE) and growth; NODE:NAME=VALUE for one mesh, a file by its
    #: stem; growth=none takes its material's growth back. Of a scene of Mitsuba's: a value of its $NAME.
    param: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    #: Seed of the texture that a generator makes, or of the order of corner tiles; a material of one patch takes none.
    #: Default: 0.
    seed: int | None = None
    #: Another SEED, and the SHARE, from 0 to 1, by which z goes from that of --seed toward that of SEED; phases stay those of
    #: --seed. For generators that were trained with a latent z.
    latent: tuple[int, float] | None = None
    #: Height of the shell in the mesh's unit; default: the material's own thickness times --scale, or 1/25 of the bounding
    #: box's diagonal.
    thickness: float | None = None
    #: Image over the UV square of how high the material grows (grey): white as high as --thickness, black not at all.
    growth: Path | None = None
    #: World length of one texture patch in the mesh's unit; default: --thickness over the material's own (1 for bundled ones);
    #: of a surface material 2/25 of the bounding box's diagonal.
    scale: float | None = None
    #: Width and height of the picture in pixels; default: 512 512, or what a scene of Mitsuba's says.
    size: tuple[int, int] | None = None
    #: Direction toward a distant light, x y z in the mesh's axes; may be repeated. Default: the suns of a
    #: glTF file or a USD stage; without any, none with an --environment or a lamp, else key, fill and bounce.
    light: Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction] = ()
    #: Light by the suns and lamps of a glTF file or a USD stage, and by the stage's sky, where no --light is given. Engine jax
    #: replaces each lamp by a distant light: with the lamp's mean light on what is grown, from the same side.
    suns: bool = True
    #: Irradiance of each light on a plane facing it; 3.14 makes a white wall white, grass reflects a fifth of that.
    irradiance: float = IRRADIANCE
    #: Latitude-longitude EXR or HDR that lights the scene and is seen behind it; its middle lies toward +x, as in Blender.
    #: Default: the dome light of a USD stage, where no --light is given.
    environment: Path | None = None
    #: Diffuse colour of the surface under the shell, of each --object, and of a file's other meshes without a material, linear
    #: R G B.
    base: tuple[float, float, float] = EARTH
    #: Further meshes in the same frame that cast and receive shadows; may be repeated. FILE=MATERIAL grows a material on it.
    object: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    #: Eye x y z, target x y z and vertical field of view in degrees; default: the first of a glTF file or a USD stage, else it
    #: frames the mesh from the upper front.
    camera: tuple[float, float, float, float, float, float, float] | None = None
    #: The axis that points up; default: what a USD stage or a COLLADA file says, z for PLY, STL and 3MF, y for all
    #: others.
    up: Literal["y", "z"] | None = None
    #: Make the background transparent even where an environment is given.
    transparent: bool = False
    #: Leave the picture transparent where it would show an --object, to lay it over a render that shows them; they still cast
    #: and receive shadows. Only for shells with --engine jax.
    holdout: bool = False
    #: jax marches rays, with direct light only; mitsuba traces paths, with indirect light too.
    engine: Literal["jax", "mitsuba"] = "jax"
