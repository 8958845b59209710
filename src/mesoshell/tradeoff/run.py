"""Measure one scene's settings until time is up, in a folder that a later run goes on with.

Notation
folder      reference.npz (reference.py), points.json, pictures/NAME.png (a point's means of 1, 2, 4, … passes
            above their error maps); at the end front.json, points.csv and report.html (page.py)
"""

import csv
import html
import io
import json
import math
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import Argument, InputError
from mesoshell.interrupt import StopRequest
from mesoshell.io.atomic import probe_outputs, replace_file
from mesoshell.io.image import srgb_to_linear, write_png
from mesoshell.io.records import read_object
from mesoshell.measure.flip import POWER
from mesoshell.render.effects import PATHS
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.accumulate import over_backdrop
from mesoshell.scene.picture import Passes, Prepared
from mesoshell.tradeoff.front import Entry, entries, front
from mesoshell.tradeoff.knobs import OF_SETUP, changes, describe_changes, knobs_of, noise_of, settings_of
from mesoshell.tradeoff.points import Point, error_map, measure_point, picture_path
from mesoshell.tradeoff.reference import Reference, is_same_scene, render_reference
from mesoshell.tradeoff.search import around, propose, singles

#: Share of the time for the reference; its noise is enough at AIM, FLIP; most points; how many times the reference's squared
#: error an entry's must be to count as certain: then its noise changes the error by 4% at most.
SHARE, AIM, MAX_POINTS, CLEAR = 0.3, 0.001, 400, 10.0
NORMAL, REFERENCE = PRESETS["normal"], PRESETS["reference"]
#: Called with the share done, 0 to 1, and what is done.
ShowStage = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """What was measured. names: the knobs that the pictures depend on; notes: what the user should know, a line each."""

    engine: str
    names: tuple[str, ...]
    reference: Reference
    points: tuple[Point, ...]
    folder: Path
    notes: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """The report, for a notebook."""
        shown = html.escape((self.folder / "report.html").read_text())
        return f'<iframe srcdoc="{shown}" style="width:100%;height:50em;border:0"></iframe>'

    @property
    def front(self) -> list[Entry]:
        """By seconds."""
        return front(entries(self.points))

    @property
    def by_evaluations(self) -> list[Entry]:
        """The front by network queries, which no machine's noise moves."""
        return front(entries(self.points), lambda e: e.evaluations)

    def preset(self, name: str) -> Point | None:
        """The point of a preset."""
        return next((p for p in self.points if p.settings == settings_of(PRESETS[name], self.names)), None)

    @property
    def certain(self) -> float:
        """The least FLIP at which the reference is CLEAR times as accurate, in squared error."""
        return CLEAR ** (1 / POWER) * self.reference.noise


def begin(folder: Path, minutes: float) -> None:
    """Check, before any work, what `explore` is given. Raises InputError."""
    if not (math.isfinite(minutes) and minutes > 0):
        raise InputError(Argument("minutes"), f"must be above 0, not {minutes:g}")
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "is a file")
    probe_outputs([folder / "report.html"])


def explore(
    prepare: Callable[[Quality], Prepared], fixed: Sequence[str], folder: Path, minutes: float, show: ShowStage
) -> Tradeoff:
    """Measure a scene's settings for so many minutes, those of earlier runs in the folder not again. prepare: the scene for a
    quality; fixed: fields that it sets itself. SIGINT or SIGTERM ends it after the point under way; there is always one. Raises
    InputError for a folder that holds another scene's."""
    begin(folder, minutes)
    begun, limit = time.perf_counter(), 60 * minutes
    scene = _Scenes(prepare)
    names = knobs_of(scene.used(), fixed)
    same = scene.engine != PATHS.name
    exact = scene.passes(REFERENCE if same else REFERENCE.with_changes(**noise_of(NORMAL, names)))
    try:
        (folder / "pictures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}") from error
    with StopRequest() as stop:

        def share(what: str) -> Callable[[float], None]:
            return lambda part: show(min(1.0, (time.perf_counter() - begun) / limit), what)

        kept = _kept_reference(folder, exact)
        points = [] if kept is None else [p for p in _kept_points(folder) if tuple(p.settings) == names]
        if kept is None:
            kept = render_reference(exact, same, SHARE * limit, AIM, share("reference"), lambda: stop.requested)
            _keep_reference(folder, kept)
        for settings in _wanted(names, points):
            usual = np.median([p.first + p.seconds[1] * p.samples[-1] for p in points]) if points else 0.0
            late = time.perf_counter() - begun + usual > limit
            if points and (stop.requested or len(points) >= MAX_POINTS or late):
                break
            quality = NORMAL.with_changes(**settings)
            point, images = measure_point(settings, scene.passes(quality), kept, share(describe_changes(settings)))
            points.append(point)
            _keep(folder, points, images, kept)
    made = Tradeoff(scene.engine, names, kept, tuple(points), folder, scene.notes)
    _summarise(made)
    return made


class _Scenes:
    """The scene as it is prepared for qualities, once for all that differ in no field of OF_SETUP: with all texels, as pictures
    without a filter need them."""

    def __init__(self, prepare: Callable[[Quality], Prepared]):
        self.prepare, self.prepared = prepare, {}

    def key(self, quality: Quality) -> tuple:
        return tuple(getattr(quality, name) for name in OF_SETUP)

    def passes(self, quality: Quality) -> Passes:
        key = self.key(quality)
        if key not in self.prepared:
            self.prepared[key] = self.prepare(quality.with_changes(filtering=False))
        return self.prepared[key].passes(quality)

    def used(self) -> list[str]:
        """Fields that some preset's picture depends on."""
        names: list[str] = []
        filtered = NORMAL.with_changes(density="network")
        for preset in (*PRESETS.values(), filtered):  # in Mitsuba a record is of the last passes that were begun
            passes = self.passes(preset)
            names += passes.ended(np.zeros((*passes.shape, 4)), 1).record["quality"]
        return names

    @property
    def engine(self) -> str:
        return next(iter(self.prepared.values())).engine

    @property
    def notes(self) -> tuple[str, ...]:
        return self.prepared[self.key(NORMAL)].notes


def _wanted(names: Sequence[str], points: list[Point]) -> Iterator[dict[str, Any]]:
    """Settings that have no point yet, in the order of their use; `points` grows as they are measured."""

    def fresh(many: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        for settings in many:
            if settings not in [p.settings for p in points]:
                yield settings

    yield from fresh(singles(names))
    others = fresh(around(names))
    for turn in range(10**6):
        settings = next(others, None) if turn % 3 == 2 else propose(points)
        if settings is not None:
            yield settings
        elif turn % 3 != 2:
            yield from others
            return


def _kept_points(folder: Path) -> list[Point]:
    """The folder's points. Raises InputError if they are none."""
    path = folder / "points.json"
    if not path.exists():
        return []
    try:
        return [Point.of(row) for row in read_object(path)["points"]]
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(path, "holds no points of a tradeoff") from error


def _kept_reference(folder: Path, exact: Passes) -> Reference | None:
    """The folder's reference; None if it has none. Raises InputError if it is of another scene."""
    path = folder / "reference.npz"
    if not path.exists():
        return None
    try:
        with np.load(path) as held:
            kept = Reference(held["image"], held["first"], *(held[name].item() for name in Reference._fields[2:]))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(path, "is no reference of a tradeoff") from error
    pixels = np.arange(exact.shape[0] * exact.shape[1])
    if not is_same_scene(kept, exact, lambda p: p.render(0, pixels, lambda share: None).reshape(*p.shape, 4)):
        raise InputError(folder, "holds the tradeoff of another scene: choose another folder")
    return kept


def _keep_reference(folder: Path, reference: Reference) -> None:
    file = io.BytesIO()
    np.savez(file, **reference._asdict())
    write_png(folder / "reference.png", over_backdrop(reference.image))
    replace_file(folder / "reference.npz", file.getvalue())


def _keep(folder: Path, points: Sequence[Point], images: np.ndarray, reference: Reference) -> None:
    """Keep the last point: its means of passes first."""
    from matplotlib import colormaps

    heat = colormaps["magma"]
    maps = [srgb_to_linear(heat(error_map(image, reference))[..., :3]) for image in images]
    rows = [np.concatenate([over_backdrop(image) for image in images], axis=1), np.concatenate(maps, axis=1)]
    write_png(picture_path(folder, points[-1]), np.concatenate(rows, axis=0).astype(np.float32))
    kept = json.dumps({"points": [p.as_dict() for p in points]}, indent=1)
    replace_file(folder / "points.json", (kept + "\n").encode())


def _summarise(made: Tradeoff) -> None:
    """Write front.json, points.csv and report.html."""
    from mesoshell.tradeoff.page import page

    described = {
        "engine": made.engine,
        "reference": {k: getattr(made.reference, k) for k in ("noise", "passes")},
        "seconds": [_entry(made, e) for e in made.front],
        "evaluations": [_entry(made, e) for e in made.by_evaluations],
    }
    replace_file(made.folder / "front.json", (json.dumps(described, indent=1) + "\n").encode())
    replace_file(made.folder / "points.csv", _table(made).encode())
    replace_file(made.folder / "report.html", page(made).encode())


def _entry(made: Tradeoff, e: Entry) -> dict[str, Any]:
    return {
        "samples": e.samples,
        "settings": changes(e.point.settings),
        "seconds": e.seconds,
        "evaluations": e.evaluations,
        "flip": e.flip,
        "bias": e.point.bias,
        "noise": e.point.noise,
        "clear": e.flip >= made.certain,
    }


def _table(made: Tradeoff) -> str:
    """A row for each point and number of samples a pixel, which is `pixel_samples`."""
    file = io.StringIO()
    numbers = ("pixel_samples", "seconds", "lower", "upper", "compiling", "evaluations", "flip", "spread", "relative")
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow([*made.names, *numbers, "bias", "noise", "bias2", "variance"])
    for p in made.points:
        low, median, high = p.seconds
        for n, flip, spread, relative in zip(p.samples, p.flip, p.spread, p.relative, strict=True):
            of_pass = [n, n * median, n * low, n * high, p.first, n * p.evaluations, flip, spread, relative]
            rows.writerow(chain(p.settings.values(), of_pass, [p.bias, p.noise, p.bias2, p.variance]))
    return file.getvalue()
