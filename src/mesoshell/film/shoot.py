"""Shoot a film: frames into a folder; a film that was interrupted goes on where it stopped.

A folder holds 00000.png, 00001.png … and film.json, whose `frames` have the seconds and the flicker of each. `of` is a hash
of all that the pictures depend on: a folder with another one is refused.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, is_dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from mesoshell import __version__
from mesoshell.errors import Argument, InputError
from mesoshell.film.crew import alone
from mesoshell.film.flicker import FrameView, flicker, frame_view
from mesoshell.film.frame import Crew, Shot, Task, compiled_in
from mesoshell.film.keys import Keys, follow
from mesoshell.film.motion import Motion
from mesoshell.film.motion import dolly as toward
from mesoshell.film.motion import orbit as around
from mesoshell.film.mp4 import check_mp4, write_mp4
from mesoshell.film.wind import add_wind
from mesoshell.io.atomic import probe_folder, replace_file
from mesoshell.io.image import read_picture, srgb_codes
from mesoshell.io.lock import alone_in
from mesoshell.io.records import read_object
from mesoshell.render.camera import Camera
from mesoshell.render.quality import Quality
from mesoshell.scene.defaults import back_light
from mesoshell.scene.growth import meshes_of
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.picture import Progress
from mesoshell.scene.prepare import prepare
from mesoshell.scene.scene import Scene
from mesoshell.scene.settle import settle, with_textures
from mesoshell.scene.setup import box_of, camera_of, up_axis
from mesoshell.scene.unpack import unpack

RECORD = "film.json"
#: How many times its distance away a dolly begins.
FAR = 8.0
#: Called with frames done and frames in all.
ShowFrames = Callable[[float, int], None]


@dataclass(frozen=True)
class Film:
    """A film on the disk. frames: paths in order; seconds: that each took to make; flicker: of each against the one before,
    None for the first or where they share too little; notes: what the user should know, a line each."""

    frames: tuple[Path, ...]
    seconds: tuple[float, ...]
    flicker: tuple[float | None, ...]
    notes: tuple[str, ...]

    def save(self, path: str | PathLike[str], fps: float = 24.0) -> None:
        """Write it over white as an MP4, H.264 that browsers play. fps: frames a second. Raises InputError for another
        suffix, an odd width or height, or if it cannot be written."""
        height, width = on_white(self.frames[0]).shape[:2]
        check_mp4(Path(path), (width, height), fps, Argument("path"))
        write_mp4(Path(path), map(_bytes, self.frames), (width, height), fps)


def shoot(
    scene: Scene,
    motion: Callable[[Scene], Motion],
    folder: Path,
    quality: Quality,
    engine: str = "jax",
    grown: Progress = lambda share: None,
    show: ShowFrames = lambda done, count: None,
    crew: Crew = alone,
) -> Film:
    """Render the frames that are not there yet. motion: of the settled scene; grown: progress of its texture; crew: who makes
    them. Raises InputError, also for a folder that holds another film's frames."""
    probe_folder(folder, Argument("folder"))
    begun = settle(scene, texture=False)
    moves = motion(begun)
    of = _identity(begun, moves, quality, engine)
    _rows(folder, of)  # another film is refused before anything is grown
    still = with_textures(begun, grown, moves.shape)
    shot = Shot(still, quality, engine, compiled_in() if engine == "jax" else None)
    first = moves.change(0)
    vary = any("params" in own for own in (first, *first.get("also", {}).values()))
    some = [] if vary else sorted({0, moves.count // 2, moves.count - 1})
    if not _bakes([shot.scene(moves.change(k)) for k in some], quality, engine):
        shot = replace(shot, quality=quality.with_changes(density="network"))
    paths = tuple(folder / f"{k:05d}.png" for k in range(moves.count))
    with alone_in(folder):
        rows = _rows(folder, of)
        missing = [k for k, path in enumerate(paths) if str(k) not in rows or not path.exists()]
        there = moves.count - len(missing)
        for k in missing:  # what was known of a frame that is lost
            rows.pop(str(k), None)
        notes: dict[str, None] = {}
        measured = _flickers(paths, rows, lambda k: _view(shot.scene(moves.change(k))))
        if next(measured) or missing:  # what the folder holds is known before its first frame is there
            _write(folder, of, engine, rows)
        tasks = (Task(k, moves.change(k), paths[k]) for k in missing)
        with closing(crew(shot, tasks, len(missing), lambda s: show(there + s, moves.count))) as frames:
            show(there, moves.count)
            for made in frames:
                if not paths[made.k].exists():
                    raise InputError(
                        folder, f"has no frame {made.k}, which a worker made: workers must share the folder"
                    )
                rows[str(made.k)] = {"seconds": made.seconds}
                notes |= dict.fromkeys(made.notes)
                there += 1
                next(measured)
                _write(folder, of, engine, rows)
                show(there, moves.count)
    done = [rows[str(k)] for k in range(moves.count)]
    return Film(paths, tuple(x["seconds"] for x in done), tuple(x["flicker"] for x in done), tuple(notes))


def _flickers(
    paths: Sequence[Path], rows: dict[str, dict[str, Any]], view_of: Callable[[int], FrameView]
) -> Iterator[int]:
    """Write the flicker of each frame into its row, as far as frames are there; at each step, gives how many were written."""
    before: tuple[FrameView, np.ndarray] | None = None
    count = 0
    for k, path in enumerate(paths):
        while str(k) not in rows or not path.exists():
            yield count
            count = 0
        view, shown = view_of(k), on_white(path)
        if "flicker" not in rows[str(k)]:
            rows[str(k)]["flicker"] = None if before is None else flicker(before[1], shown, before[0], view)
            count += 1
        before = view, shown
    while True:
        yield count
        count = 0


def on_white(path: Path) -> Float[np.ndarray, "H W 3"]:
    """A frame over white, linear, as a screen shows it."""
    rgba = read_picture(path)
    return np.clip(rgba[..., :3] + (1 - rgba[..., 3:]), 0, 1)


def plan_motion(
    scene: Scene,
    orbit: int | None = None,
    dolly: int | None = None,
    far: float | None = None,
    keys: Keys | None = None,
    wind: float | None = None,
    fps: float = 24.0,
) -> Callable[[Scene], Motion]:
    """The motion of a scene that is settled, by the one of `orbit`, `dolly` and `keys` that is given, with wind toward the
    camera's right if it has a strength. far: of a dolly, FAR if not given. Raises InputError unless it is one, or for `far`
    without `dolly`."""
    given = [name for name, value in (("orbit", orbit), ("dolly", dolly), ("keys", keys)) if value is not None]
    if len(given) != 1:
        raise InputError(Argument(given[-1] if given else "orbit"), "give one of `orbit`, `dolly` and `keys`")
    if far is not None and dolly is None:
        raise InputError(Argument("far"), "is where a `dolly` begins: give `dolly` too")
    scene = unpack(scene)
    aimed, unlit = scene.camera, not scene.lights and not scene.lamps and scene.environment is None

    def motion(still: Scene) -> Motion:
        moves = moved(still)
        if wind is None:
            return moves
        right = _camera(replace(still, **{k: x for k, x in moves.change(0).items() if k == "camera"})).to_world[:3, 0]
        return add_wind(moves, still, right, wind, fps)

    def moved(still: Scene) -> Motion:
        if keys is not None:
            return follow(keys, still)
        camera = _camera(still)
        box = box_of(meshes_of(still)).astype(np.float64)
        pivot = box.mean(axis=0) if aimed is None or isinstance(aimed, Camera) else np.array(aimed[3:6], np.float64)
        if orbit is not None:
            lights = (*still.lights, back_light(camera, up_axis(still), still.irradiance)) if unlit else None
            return around(camera, pivot, up_axis(still), orbit, lights)
        assert dolly is not None
        return toward(camera, pivot, FAR if far is None else far, dolly)

    return motion


def _bytes(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    """A frame over white, sRGB."""
    return srgb_codes(on_white(path))


def _camera(still: Scene) -> Camera:
    return camera_of(still, meshes_of(still), up_axis(still))


def _view(frame: Scene) -> FrameView:
    """What the flicker of a frame is measured on."""
    thickness = [one.thickness or 0.0 for one in (frame, *frame.also)]
    grown = list(zip(meshes_of(frame), thickness, strict=True))
    return frame_view(_camera(frame), grown, tuple(map(mesh_of, frame.objects)))


def _write(folder: Path, of: str, engine: str, rows: dict[str, dict[str, Any]]) -> None:
    record = {"version": __version__, "of": of, "engine": engine, "frames": rows}
    replace_file(folder / RECORD, (json.dumps(record, indent=1) + "\n").encode())


def _rows(folder: Path, of: str) -> dict[str, dict[str, Any]]:
    """Rows of the frames that are there. Raises InputError if they are another film's. One that ended without a frame does not
    count: what its cluster may still have written is made again."""
    path = folder / RECORD
    if not path.exists():
        if any(folder.glob("[0-9]" * 5 + ".png")):
            raise InputError(folder, f"holds frames but no {RECORD}, so their film is unknown: choose another folder")
        return {}
    try:
        record = read_object(path)
        same = record["of"] == of
        rows = {str(k): {**x, "seconds": float(x["seconds"])} for k, x in record["frames"].items()}
    except (InputError, ValueError, TypeError, KeyError, AttributeError) as fault:
        raise InputError(path, "is no record of a film: remove the folder, or choose another") from fault
    if not same and rows:
        raise InputError(folder, "holds another film's frames: remove the folder, or choose another")
    return rows


def _bakes(frames: list[Scene], quality: Quality, engine: str) -> bool:
    """Whether density is baked in all of some frames: a film should not change its look on the way. None of it is if no frame
    is given: a grid is of one frame's parameters."""
    if quality.density == "network" or not frames:
        return False
    plans = (prepare(frame, quality, engine).effects for frame in frames)
    return all(plan is not None and plan.baked_density.on for plan in plans)


def _identity(begun: Scene, moves: Motion, *rest: Any) -> str:
    sha = hashlib.sha256(__version__.encode())
    _feed(sha, (begun, *rest))
    for k in range(moves.count):
        _feed(sha, moves.change(k))
    return sha.hexdigest()


def _feed(sha: Any, part: Any) -> None:
    """Add what a part holds: arrays by their bytes, containers by their parts, all else by its text."""
    if isinstance(part, np.ndarray):
        sha.update(f"{part.dtype}{part.shape}".encode())
        sha.update(np.ascontiguousarray(part).data)
    elif is_dataclass(part) and not isinstance(part, type):
        names = [field.name for field in fields(part) if field.name != "notes"]  # may name a temporary folder
        _feed(sha, {name: getattr(part, name) for name in names})
    elif isinstance(part, Mapping):
        for key in sorted(part):
            _feed(sha, (key, part[key]))
    elif isinstance(part, str | PathLike):
        sha.update(f"{part!r}".encode())
    elif isinstance(part, Sequence):
        sha.update(f"[{len(part)}".encode())
        for item in part:
            _feed(sha, item)
    else:
        sha.update(repr(part).encode())
