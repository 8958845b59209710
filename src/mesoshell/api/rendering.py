"""Render and explain scenes. Importing it loads no JAX."""

from os import PathLike
from pathlib import Path
from typing import Any, Literal

from mesoshell.errors import Argument, InputError
from mesoshell.film.crew import crew_of
from mesoshell.film.keys import Keys
from mesoshell.film.shoot import Film, plan_motion, shoot
from mesoshell.render.effects import Effects
from mesoshell.render.quality import Quality
from mesoshell.scene.accumulate import goal_of
from mesoshell.scene.mitsuba_xml import write_folder
from mesoshell.scene.picture import Picture, Progress
from mesoshell.scene.prepare import FIXED_BY_XML, prepare, quality_of
from mesoshell.scene.reach import picture_of
from mesoshell.scene.scene import Scene
from mesoshell.stability.report import Stability
from mesoshell.tradeoff.run import ShowStage, Tradeoff, explore

Engine = Literal["jax", "mitsuba"]


def render(
    scene: Scene,
    quality: str | Quality | None = None,
    *,
    engine: Engine = "jax",
    budget: float | None = None,
    error: float | None = None,
    max_samples: int | None = None,
    progress: Progress = lambda share: None,
    **changes: Any,
) -> Picture:
    """A picture of a scene, as `mesoshell render` makes it, bit for bit.

    quality: "draft", "normal", "reference" or a Quality; changes: of its fields, such as samples=64. engine: "jax" marches
    rays, with direct light only; "mitsuba" traces paths, with indirect light too. budget: seconds of the render loop, error:
    mean FLIP, max_samples: of a pixel; with any of these the picture is made pass by pass and ends at the first that is met, or
    at Ctrl-C, and the report's "goal" says what was promised and reached. Without a quality it is "normal"; for a goal, its
    march is changed as the scene needs. progress: called with the share done, 0 to 1. Raises InputError, which names the
    argument or the file at fault.
    """
    goal = goal_of(budget, error, max_samples, changes)
    wanted = quality_of("normal" if quality is None else quality, engine, changes)
    return picture_of(prepare(scene, wanted, engine), wanted, goal, quality is None and not changes, progress)


def explain(scene: Scene, quality: str | Quality = "normal", *, engine: Engine = "jax", **changes: Any) -> Effects:
    """Which effects a scene calls for, and why; prints as a line each. Nothing is rendered. Arguments: see `render`."""
    effects = prepare(scene, quality_of(quality, engine, changes), engine).effects
    assert effects is not None  # None only for a scene of Mitsuba's own
    return effects


def stability(
    scene: Scene, *, engine: Engine = "jax", rays: int = 100_000, progress: Progress = lambda share: None
) -> Stability:
    """Check a scene for numerical problems, as `mesoshell stability` does: folded prisms, edges, grazing rays, precision, by
    oracles in float64.

    Prints one line per check; `.broken` holds the checks that failed; a notebook displays the map of problem places. engine:
    "mitsuba" checks the path tracer's walk and picture too. rays: number of test rays; the camera's rays are added.
    Raises InputError.
    """
    from mesoshell.stability.examine import examine

    quality_of("normal", engine, {})  # an engine that there is
    return examine(scene, rays, progress, engine)


def write_scene(scene: Scene, folder: str | PathLike[str], *, quality: str | Quality = "normal") -> Path:
    """Write a scene as a folder, as `mesoshell scene` does: the path of its scene.xml, for `ms.mitsuba.load_file`.

    quality: for paths a pixel and their depths; its other fields are given when it is loaded. Needs no Mitsuba. Raises
    InputError, also if the folder exists.
    """
    return write_folder(scene, Path(folder), quality_of(quality, "mitsuba", {}))[0]


def film(
    scene: Scene,
    folder: str | PathLike[str],
    *,
    orbit: int | None = None,
    dolly: int | None = None,
    far: float | None = None,
    keys: Keys | None = None,
    wind: float | None = None,
    fps: float = 24.0,
    quality: str | Quality = "normal",
    engine: Engine = "jax",
    workers: int | None = None,
    scheduler: str | None = None,
    progress: ShowStage = lambda share, what: None,
    **changes: Any,
) -> Film:
    """Frames of a scene over time, as `mesoshell film` makes them: `.frames` are their paths, `.flicker` what differs between
    neighbours beside the camera's motion; `.save("film.mp4")` writes an MP4.

    folder: for the frames; those of an earlier call that was stopped are kept. Give one of orbit: frames of a turn around what
    the camera looks at; dolly: frames of a way toward it from `far` times its distance (8 if not given); keys: {"frame": 0,
    "camera": seven numbers, "params": {...}, "thickness": ...} each, smooth between them. wind: strength, to 1, of gusts toward
    the camera's right, for materials with a lean; fps: frames a second. quality, engine, changes: as of `render`. workers:
    processes that render frames side by side; scheduler: address of a Dask scheduler whose workers do, which see the folder
    under the same path. progress: called with the share done, and what is done. Raises InputError, also for a folder that holds
    another film's frames.
    """
    chosen = quality_of(quality, engine, changes)
    motion = plan_motion(scene, orbit, dolly, far, keys, wind, fps)
    step = lambda done, count: progress(done / count, f"frame {min(int(done) + 1, count)} of {count}")  # noqa: E731
    crew = crew_of(workers, scheduler)
    return shoot(scene, motion, Path(folder), chosen, engine, lambda share: progress(share, "growing"), step, crew)


def tradeoff(
    scene: Scene | str | PathLike[str],
    folder: str | PathLike[str],
    *,
    engine: Engine = "jax",
    minutes: float = 10.0,
    pixels: int = 96 * 96,
    progress: ShowStage = lambda share, what: None,
) -> Tradeoff:
    """What accuracy costs in time in a scene, as `mesoshell tradeoff` measures it: `.front` has what no other settings beat in
    both, `.points` all that were measured; a notebook displays report.html.

    scene: or an XML file of Mitsuba's, with engine "mitsuba". folder: gets report.html, front.json and points.csv; what an
    earlier call measured there of the same scene is not measured again. minutes: that it takes, but for starting. pixels: most
    of a scene of Mitsuba's, which keeps its proportions. progress: called with the share done, and what is done. Raises
    InputError, also for a folder that holds another scene's.
    """
    quality_of("normal", engine, {})  # an engine that there is
    if isinstance(scene, Scene):
        return explore(lambda quality: prepare(scene, quality, engine), (), Path(folder), minutes, progress)
    if engine != "mitsuba":
        raise InputError(Path(scene), "is a scene of Mitsuba's, which requires `engine` mitsuba")
    from mesoshell.scene.render_paths import prepare_file

    if pixels < 1:
        raise InputError(Argument("pixels"), f"must be at least 1, not {pixels}")
    of_file = lambda quality: prepare_file(Path(scene), quality, None, pixels=pixels)  # noqa: E731
    return explore(of_file, FIXED_BY_XML, Path(folder), minutes, progress)
