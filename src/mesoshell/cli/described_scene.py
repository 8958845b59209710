"""The scene that options describe, ready for the engine that they name. Only that engine is imported."""

from dataclasses import fields
from pathlib import Path

from mesoshell.cli.checks import first_given, pairs_of
from mesoshell.cli.grown import PROPORTIONS, grown_of
from mesoshell.cli.progress import say_notes, stderr
from mesoshell.cli.scene_options import SceneOptions
from mesoshell.errors import Argument, InputError
from mesoshell.render.quality import Quality
from mesoshell.scene.defaults import SIZE
from mesoshell.scene.materials import Material
from mesoshell.scene.picture import Prepared, Progress
from mesoshell.scene.prepare import prepare
from mesoshell.scene.scene import Scene
from mesoshell.scene.setup import check_size

#: Options that a scene of Mitsuba's takes, and why it does not take those that it cannot set itself.
OF_XML = ("mesh", "engine", "param", "size")
NOT_OF_XML = {
    "grow": "names nodes of a glTF file or a USD stage: a scene of Mitsuba's says by its BSDFs what grows",
    "latent": "is for meshes: make a texture (mesoshell texture --latent), and name it in the scene",
    "growth": "is for meshes: a scene of Mitsuba's has one thickness a mesh",
    "holdout": "is for --engine jax: a scene of Mitsuba's holds nothing out",
}


def is_mitsubas(mesh: Path) -> bool:
    """Whether a path is that of a scene of Mitsuba's."""
    return mesh.suffix.lower() == ".xml"


def prepare_with_bar(
    options: SceneOptions, quality: Quality, samples: int | None, progress: Progress, shrink: bool = False
) -> Prepared:
    """The scene, ready to be rendered. samples: paths a pixel of a scene of Mitsuba's; None: as many as it says. progress: of
    growing a texture. shrink: whether the size's number of pixels is the most of a scene of Mitsuba's. Raises InputError."""
    if not is_mitsubas(options.mesh):
        return prepare(scene_of(options), quality, options.engine, progress)
    size, names = options.size, names_of_xml(options)
    from mesoshell.scene.render_paths import prepare_file

    if shrink:
        width, height = check_size(Argument("size"), size or SIZE)
        return prepare_file(options.mesh, quality, samples, names, pixels=width * height)
    return prepare_file(options.mesh, quality, samples, names, size)


def names_of_xml(options: SceneOptions) -> dict[str, str]:
    """Values of the $NAMEs of a scene of Mitsuba's. Raises InputError for options that it does not take."""
    if options.engine != "mitsuba":
        raise InputError(options.mesh, "is a scene of Mitsuba's, which requires --engine mitsuba")
    given = first_given(options, {field.name for field in fields(SceneOptions)} - set(OF_XML))
    if given is not None:
        name, option = given
        raise InputError(option, NOT_OF_XML.get(name, f"is set in {options.mesh}"))
    return pairs_of("--param", options.param)


def scene_of(options: SceneOptions, material: Material | None = None) -> Scene:
    """The scene that the options describe. material: in the place of the option's. Raises InputError for a parameter without a
    value, or a material that cannot be used."""
    named = grown_of(options, material)
    say_notes(stderr(), named.notes)
    own = {name: getattr(options, name) for name in PROPORTIONS}
    own = named.told | {name: value for name, value in own.items() if value is not None}
    return Scene(
        mesh=options.mesh,
        material=named.material,
        params=named.params,
        **own,
        size=options.size or SIZE,
        camera=options.camera,
        lights=options.light,
        irradiance=options.irradiance,
        environment=options.environment,
        base_colour=options.base,
        objects=named.objects,
        up=options.up,
        transparent=options.transparent,
        grow=named.grow,
        also=named.also,
        holdout=options.holdout,
        suns=options.suns,
    )


def compiled_by(engine: str) -> list[float] | None:
    """Keep what an engine compiles for later commands; a list that collects the seconds, None for Mitsuba, which does so
    itself."""
    if engine != "jax":
        return None
    from mesoshell.cli.compilation_cache import keep_compiled

    return keep_compiled()
